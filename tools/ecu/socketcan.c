/* The wire: Linux SocketCAN, `ecu-can vcan0`. */
#include "wire.h"

#include <linux/can.h>
#include <linux/can/raw.h>
#include <net/if.h>
#include <poll.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <unistd.h>

static int can = -1;

bool wire_open(const char *name)
{
    struct ifreq interface = {0};
    struct sockaddr_can address = {0};

    can = socket(PF_CAN, SOCK_RAW, CAN_RAW);
    if (can < 0) {
        return false;
    }
    strncpy(interface.ifr_name, name, sizeof interface.ifr_name - 1u);
    if (ioctl(can, SIOCGIFINDEX, &interface) < 0) {
        return false;
    }
    address.can_family = AF_CAN;
    address.can_ifindex = interface.ifr_ifindex;
    return bind(can, (const struct sockaddr *)&address, sizeof address) == 0;
}

bool wire_send(const struct liftgate_frame *frame)
{
    struct can_frame out = {0};

    if (frame->length > sizeof out.data) {
        return false;
    }
    out.can_id = frame->id;
    out.can_dlc = frame->length;
    memcpy(out.data, frame->data, frame->length);
    return write(can, &out, sizeof out) == (ssize_t)sizeof out;
}

bool wire_receive(struct liftgate_frame *frame, int timeout)
{
    struct pollfd ready = {can, POLLIN, 0};
    struct can_frame in;

    if (poll(&ready, 1, timeout) <= 0 || read(can, &in, sizeof in) != (ssize_t)sizeof in) {
        return false;
    }
    frame->id = in.can_id;
    frame->length = in.can_dlc <= sizeof in.data ? in.can_dlc : 0u;
    frame->flags = 0u;
    memcpy(frame->data, in.data, frame->length);
    return true;
}

void wire_close(void)
{
    close(can);
}
