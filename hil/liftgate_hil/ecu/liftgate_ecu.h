/*
 * An ECU as a C library that liftgate-hil loads and closes the loop with: `--ecu path/to/library.so`. C99 or C++.
 *
 * The library exports the functions below. In one episode they are called in this order, from one thread:
 *
 *     void *ecu = liftgate_ecu_create();
 *     at each tick of the model:
 *         liftgate_ecu_request(ecu, action);          (only where the scenario says so)
 *         liftgate_ecu_step(ecu, now_ns, ...);
 *     liftgate_ecu_destroy(ecu);
 *
 * The ECU's time is `now_ns`, never the computer's clock: an episode may run slower or faster than that, and the
 * same calls are to give the same frames. Each episode loads the library anew into a process of its own and makes
 * one instance there, so that generated code may keep its state in file statics.
 *
 * Build it with  cc -shared -fPIC -fvisibility=hidden -o ecu.so ...  and include this file where the functions are
 * defined: it is what makes them visible.
 */
#ifndef LIFTGATE_ECU_H
#define LIFTGATE_ECU_H

#include <stdint.h>

#if defined(_WIN32)
#define LIFTGATE_ECU_EXPORT __declspec(dllexport)
#elif defined(__GNUC__)
#define LIFTGATE_ECU_EXPORT __attribute__((visibility("default")))
#else
#define LIFTGATE_ECU_EXPORT
#endif

#ifdef __cplusplus
extern "C" {
#endif

/* Flags in liftgate_frame.id, as in struct can_frame of Linux. */
#define LIFTGATE_ID_EXTENDED 0x80000000u /* the identifier has 29 bits, else 11 */
#define LIFTGATE_ID_REMOTE 0x40000000u   /* a remote request: no data */
#define LIFTGATE_ID_ERROR 0x20000000u    /* an error frame of the controller, not a message */

/* Flags in liftgate_frame.flags. */
#define LIFTGATE_FRAME_FD 1u  /* CAN FD; else classic CAN with up to 8 bytes */
#define LIFTGATE_FRAME_BRS 2u /* with CAN FD: bit rate switch */
#define LIFTGATE_FRAME_ESI 4u /* with CAN FD: error state indicator; test bits, flags may be combined */

/* A frame on the bus. No padding but two bytes at the end: 72 bytes, data at 6. */
struct liftgate_frame {
    uint32_t id;      /* identifier and LIFTGATE_ID_* */
    uint8_t length;   /* bytes in data: 0 to 8; with CAN FD also 12, 16, 20, 24, 32, 48, 64 */
    uint8_t flags;    /* LIFTGATE_FRAME_*; 0 in all other bits */
    uint8_t data[64];
};

/* What the driver asks for: liftgate_ecu_request's action. */
enum liftgate_request {
    LIFTGATE_REQUEST_STOP = 0,
    LIFTGATE_REQUEST_OPEN = 1,
    LIFTGATE_REQUEST_CLOSE = 2
};

/* A new ECU, just switched on: what the other functions get as `ecu`. NULL: it could not be made. */
LIFTGATE_ECU_EXPORT void *liftgate_ecu_create(void);

/* The end of this ECU; frees what create took. NULL does nothing. */
LIFTGATE_ECU_EXPORT void liftgate_ecu_destroy(void *ecu);

/*
 * The driver's button, an enum liftgate_request; called before the step of the tick in which it is pressed. An ECU
 * ignores actions that it doesn't know, and may leave this function out: it then gets no requests.
 */
LIFTGATE_ECU_EXPORT void liftgate_ecu_request(void *ecu, int action);

/*
 * One tick of the model, whatever the ECU's own cycle is: most ticks are none of its business.
 *
 * now_ns: model time [ns], never decreasing; the step between two calls is the tick (1 ms by default).
 * in, count: all frames that were on the bus since the last call, in their order; `in` may be NULL where count is 0.
 *     Frames of others come too, and so do remote and error frames, wrong lengths and wrong checksums.
 * out, capacity: room for what the ECU sends in this tick, in its order.
 * Returns how many frames were written to out: 0 to capacity. Any other value ends the episode as an error.
 *
 * `in` and `out` are the caller's and valid during the call only.
 */
LIFTGATE_ECU_EXPORT int liftgate_ecu_step(void *ecu, int64_t now_ns, const struct liftgate_frame *in, int count,
                                          struct liftgate_frame *out, int capacity);

#ifdef __cplusplus
}
#endif

#endif
