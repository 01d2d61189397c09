/* The wire: a serial line through liftgate_serial.h, `ecu-serial /dev/ttyUSB0`. */
#include "wire.h"

#include "liftgate_serial.h"

#include <fcntl.h>
#include <poll.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

static int port = -1;
static lgs_receiver receiver;
static uint8_t heard[256];
static size_t heard_size;
static size_t heard_at;
static bool was_cut = true; /* the line's last byte was not a zero; not known at first */

bool wire_open(const char *name)
{
    struct termios settings;

    port = open(name, O_RDWR | O_NOCTTY | O_NONBLOCK);
    if (port < 0 || tcgetattr(port, &settings) < 0) {
        return false;
    }
    cfmakeraw(&settings);
    settings.c_cflag |= CLOCAL | CREAD;
    return cfsetspeed(&settings, B921600) == 0 && tcsetattr(port, TCSANOW, &settings) == 0;
}

bool wire_send(const struct liftgate_frame *frame)
{
    uint8_t line[1u + LGS_MAX_ENCODED] = {0};
    const size_t lead = was_cut ? 1u : 0u;
    const size_t size =
        lead + lgs_encode((uint16_t)frame->id, frame->data, frame->length, line + lead, sizeof line - lead);
    const ssize_t written = size > lead ? write(port, line, size) : 0;

    if (written > 0) {
        was_cut = (size_t)written < size;
    }
    return written == (ssize_t)size;
}

bool wire_receive(struct liftgate_frame *frame, int timeout)
{
    lgs_frame in;

    for (;;) {
        while (heard_at < heard_size) {
            if (lgs_receive(&receiver, heard[heard_at++], &in) == LGS_FRAME) {
                frame->id = in.id;
                frame->length = in.length;
                frame->flags = 0u;
                memcpy(frame->data, in.data, in.length);
                return true;
            }
        }
        struct pollfd ready = {port, POLLIN, 0};
        if (poll(&ready, 1, timeout) <= 0) {
            return false;
        }
        const ssize_t size = read(port, heard, sizeof heard);
        if (size <= 0) { /* nobody there: do not spin */
            (void)poll(NULL, 0, timeout);
            return false;
        }
        heard_size = (size_t)size;
        heard_at = 0u;
    }
}

void wire_close(void)
{
    close(port);
}
