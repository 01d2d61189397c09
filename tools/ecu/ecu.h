/* The example ECU itself: frames, time and requests in, frames out. It knows no bus, no clock and no allocation. */
#ifndef ECU_H
#define ECU_H

#include "liftgate_ecu.h"

#include <stdbool.h>
#include <stdint.h>

#define ECU_CYCLE_NS INT64_C(10000000)
#define ECU_SPAN 4 /* cycles over which the speed is measured */

enum ecu_mode { ECU_WAITING, ECU_STOPPED, ECU_OPENING, ECU_OPEN, ECU_CLOSING, ECU_CLOSED, ECU_REVERSING };

/* All of its state; fields are for reading. */
struct ecu {
    /* the bus */
    double currents[2]; /* A, positive opens */
    int32_t counts[2];
    bool latched;
    unsigned heard; /* bits: left, right, gate */
    uint8_t alive;

    /* the cycle */
    bool started;
    int64_t due_ns;

    /* what was measured, at the last cycle */
    bool measured;
    struct {
        int64_t time_ns;
        int32_t count; /* mean of both drives */
    } history[ECU_SPAN + 1];
    int32_t closed_at; /* mean count of the closed gate */
    int32_t position;  /* counts above closed */
    double current;    /* A, mean of both drives */
    double speed;      /* counts/s */

    /* the motion */
    enum ecu_mode mode;
    int64_t since_ns; /* when it was entered */
    int32_t started_at; /* position then */
    int pending;        /* enum liftgate_request, or none */
    int suspect, still; /* cycles */
    double integral;
};

/* Just switched on. */
void ecu_init(struct ecu *ecu);

/* Takes effect in the next cycle in which the gate is known; until then a later request replaces it. */
void ecu_request(struct ecu *ecu, int action);

/* As liftgate_ecu_step: takes all frames, and sends one where a cycle has begun. Cycles that were missed are skipped. */
int ecu_step(struct ecu *ecu, int64_t now_ns, const struct liftgate_frame *in, int count, struct liftgate_frame *out,
             int capacity);

/* The frame that switches the motors off, whatever goes on. */
void ecu_motors_off(struct ecu *ecu, struct liftgate_frame *out);

#endif
