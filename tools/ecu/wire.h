/* What the example ECU needs of its bus: socketcan.c and serial.c are two of them. */
#ifndef WIRE_H
#define WIRE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#define WIRE_MAX_PAYLOAD 64u

struct wire_frame {
    uint32_t id;
    size_t length;
    uint8_t data[WIRE_MAX_PAYLOAD];
};

/* false: not possible, and errno says why */
bool wire_open(const char *name);

/* false: not sent */
bool wire_send(uint16_t id, const uint8_t *data, size_t length);

/* Wait up to `timeout` ms for a frame; false: none came. */
bool wire_receive(struct wire_frame *frame, int timeout);

void wire_close(void);

#endif
