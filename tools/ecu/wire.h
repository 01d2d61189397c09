/* What the programs need of their bus: socketcan.c and serial.c are two of them. */
#ifndef WIRE_H
#define WIRE_H

#include "liftgate_ecu.h"

#include <stdbool.h>

/* false: not possible, and errno says why */
bool wire_open(const char *name);

/* false: not sent */
bool wire_send(const struct liftgate_frame *frame);

/* Wait up to `timeout` ms for a frame; false: none came. */
bool wire_receive(struct liftgate_frame *frame, int timeout);

void wire_close(void);

#endif
