/*
 * The example ECU as a program on a wire: opens the gate, closes it again, and is done when it is home or has
 * reversed. `ecu-can vcan0 [SECONDS]` or `ecu-serial /dev/ttyUSB0 [SECONDS]`.
 *
 * Exit code: 0 opened and closed, or reversed; 1 not within SECONDS (default 60); 2 no such wire.
 */
#include "ecu.h"
#include "wire.h"

#include <errno.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define PAUSE_NS INT64_C(500000000) /* between open and closing */

static int64_t clock_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return INT64_C(1000000000) * t.tv_sec + t.tv_nsec;
}

static bool is_done(const struct ecu *ecu)
{
    return ecu->mode == ECU_CLOSED || ecu->mode == ECU_STOPPED;
}

static const char *name_of(const struct ecu *ecu)
{
    return ecu->mode == ECU_OPENING ? "opening"
         : ecu->mode == ECU_OPEN ? "open"
         : ecu->mode == ECU_CLOSING ? "closing"
         : ecu->mode == ECU_REVERSING ? "reversing"
                                      : "done";
}

int main(int argc, char **argv)
{
    const double limit = argc > 2 ? atof(argv[2]) : 60.0;
    struct ecu ecu;
    struct liftgate_frame in, out;

    if (argc < 2 || !wire_open(argv[1])) {
        fprintf(stderr, "%s: %s\n", argv[0], argc < 2 ? "WIRE [SECONDS]" : strerror(errno));
        return 2;
    }
    const int64_t start = clock_ns();
    int64_t now = 0;
    enum ecu_mode told = ECU_WAITING;
    ecu_init(&ecu);
    ecu_request(&ecu, LIFTGATE_REQUEST_OPEN);
    while (!is_done(&ecu) && 1e-9 * (double)now < limit) {
        const int64_t left = ecu.due_ns - now;
        const int heard = wire_receive(&in, left > 0 ? 1 + (int)(left / 1000000) : 0);
        now = clock_ns() - start;
        if (ecu_step(&ecu, now, &in, heard, &out, 1) > 0) {
            (void)wire_send(&out);
        }
        if (ecu.mode != told) {
            told = ecu.mode;
            fprintf(stderr, "%7.3f s  %s at %d counts, %.2f A\n", 1e-9 * (double)now, name_of(&ecu),
                    (int)ecu.started_at, ecu.current);
        }
        if (ecu.mode == ECU_OPEN && now - ecu.since_ns > PAUSE_NS) {
            ecu_request(&ecu, LIFTGATE_REQUEST_CLOSE);
        }
    }
    ecu_motors_off(&ecu, &out);
    (void)wire_send(&out);
    wire_close();
    return is_done(&ecu) ? 0 : 1;
}
