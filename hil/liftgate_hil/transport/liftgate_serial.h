/*
 * The serial line of liftgate-hil, for the control unit's side. One file, C99 or C++, no allocation.
 *
 * A frame on the line is COBS( id:u16le, payload, crc:u16le ) 0x00: an 11-bit identifier, 0 to 64 bytes,
 * CRC-16/IBM-3740 (CCITT-FALSE: polynomial 0x1021, initial value 0xFFFF, not reflected, no final XOR) over both.
 *
 * Sending:
 *
 *     uint8_t line[LGS_MAX_ENCODED];
 *     size_t size = lgs_encode(0x120u, payload, 8u, line, sizeof line);
 *     uart_write(line, size);
 *
 * If the UART took only a part of a frame, send one 0x00 before the next frame: the receiver then drops the
 * broken one and nothing else. Zeros between frames do no harm.
 *
 * Receiving, byte by byte, in the main loop or in an interrupt (one receiver in one context):
 *
 *     static lgs_receiver receiver;              (all zero is ready; else lgs_init)
 *     lgs_frame frame;
 *     if (lgs_receive(&receiver, byte, &frame) == LGS_FRAME) {
 *         handle(frame.id, frame.data, frame.length);
 *     }
 *
 * Everything else that lgs_receive returns may be ignored: bad frames are counted in the receiver, and the frame
 * after the next zero is whole again. A receiver takes about 100 bytes, a call some 20 operations, and the end of
 * a frame the CRC over it, about 10 operations a byte.
 */
#ifndef LIFTGATE_SERIAL_H
#define LIFTGATE_SERIAL_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define LGS_MAX_ID 0x7FFu
#define LGS_MAX_PAYLOAD 64u
#define LGS_MAX_RAW (LGS_MAX_PAYLOAD + 4u)     /* with identifier and CRC */
#define LGS_MAX_ENCODED (LGS_MAX_PAYLOAD + 6u) /* with COBS's byte and the zero at the end */

typedef struct {
    uint16_t id;
    uint8_t length;
    uint8_t data[LGS_MAX_PAYLOAD];
} lgs_frame;

typedef enum {
    LGS_PENDING = 0, /* no frame is complete yet */
    LGS_FRAME,       /* a sound one is in *frame */
    LGS_CUT,         /* bad: ended before its COBS code says */
    LGS_LONG,        /* bad: more bytes without a zero than the longest frame has */
    LGS_SHORT,       /* bad: no room for identifier and CRC */
    LGS_BAD_CRC,     /* bad */
    LGS_BAD_ID       /* bad: identifier above LGS_MAX_ID, with a sound CRC */
} lgs_status;

typedef struct {
    /* counters, modulo 2^32 */
    uint32_t frames;
    uint32_t cut;
    uint32_t too_long;
    uint32_t too_short;
    uint32_t bad_crc;
    uint32_t bad_id;
    /* the frame under way */
    uint8_t count;    /* bytes in raw */
    uint8_t left;     /* bytes until the next COBS code */
    uint8_t begun;    /* a COBS code has come */
    uint8_t skipping; /* until the next zero */
    uint8_t raw[LGS_MAX_RAW];
} lgs_receiver;

/* CRC after one more byte; starts at 0xFFFF. */
static inline uint16_t lgs_crc16(uint16_t crc, uint8_t byte)
{
    uint16_t x = (uint16_t)((uint16_t)(crc >> 8) ^ (uint16_t)byte);

    x = (uint16_t)(x ^ (uint16_t)(x >> 4));
    /* wider than 16 bits, so that no shift overflows where int has 16 */
    return (uint16_t)((((uint32_t)crc << 8) ^ ((uint32_t)x << 12) ^ ((uint32_t)x << 5) ^ (uint32_t)x)
                      & 0xFFFFu);
}

/*
 * A frame with its zero at the end into `out`; its size, at most n + 6. 0 where the identifier is above LGS_MAX_ID,
 * n is above LGS_MAX_PAYLOAD, or `out` has less than n + 6 bytes. `payload` may be NULL where n is 0.
 */
static inline size_t lgs_encode(uint16_t id, const uint8_t *payload, size_t n, uint8_t *out, size_t out_size)
{
    uint16_t crc = 0xFFFFu;
    size_t code = 0u; /* where the distance to the next zero goes */
    size_t at = 1u;
    size_t i;

    if ((id > LGS_MAX_ID) || (n > LGS_MAX_PAYLOAD) || (out == NULL) || (out_size < (n + 6u))
        || ((payload == NULL) && (n > 0u))) {
        return 0u;
    }
    for (i = 0u; i < (n + 4u); i++) {
        uint8_t byte;
        if (i == 0u) {
            byte = (uint8_t)(id & 0xFFu);
        } else if (i == 1u) {
            byte = (uint8_t)(id >> 8);
        } else if (i < (n + 2u)) {
            byte = payload[i - 2u];
        } else if (i == (n + 2u)) {
            byte = (uint8_t)(crc & 0xFFu);
        } else {
            byte = (uint8_t)(crc >> 8);
        }
        if (i < (n + 2u)) {
            crc = lgs_crc16(crc, byte);
        }
        if (byte == 0u) {
            out[code] = (uint8_t)(at - code);
            code = at;
        } else {
            out[at] = byte;
        }
        at++;
    }
    out[code] = (uint8_t)(at - code);
    out[at] = 0u;
    return at + 1u;
}

/* Forget everything, counters too. */
static inline void lgs_init(lgs_receiver *receiver)
{
    receiver->frames = 0u;
    receiver->cut = 0u;
    receiver->too_long = 0u;
    receiver->too_short = 0u;
    receiver->bad_crc = 0u;
    receiver->bad_id = 0u;
    receiver->count = 0u;
    receiver->left = 0u;
    receiver->begun = 0u;
    receiver->skipping = 0u;
}

/* Used by lgs_receive: judge what has come before a zero. */
static inline lgs_status lgs_judge(lgs_receiver *receiver, lgs_frame *frame)
{
    uint16_t crc = 0xFFFFu;
    uint16_t sent;
    uint16_t id;
    uint8_t covered;
    uint8_t i;

    if ((receiver->skipping != 0u) || (receiver->begun == 0u)) {
        return LGS_PENDING;
    }
    if (receiver->left != 0u) {
        receiver->cut++;
        return LGS_CUT;
    }
    if (receiver->count < 4u) {
        receiver->too_short++;
        return LGS_SHORT;
    }
    covered = (uint8_t)(receiver->count - 2u);
    for (i = 0u; i < covered; i++) {
        crc = lgs_crc16(crc, receiver->raw[i]);
    }
    sent = (uint16_t)(receiver->raw[covered] | ((uint32_t)receiver->raw[covered + 1u] << 8));
    if (crc != sent) {
        receiver->bad_crc++;
        return LGS_BAD_CRC;
    }
    id = (uint16_t)(receiver->raw[0] | ((uint32_t)receiver->raw[1] << 8));
    if (id > LGS_MAX_ID) {
        receiver->bad_id++;
        return LGS_BAD_ID;
    }
    frame->id = id;
    frame->length = (uint8_t)(covered - 2u);
    for (i = 2u; i < covered; i++) {
        frame->data[i - 2u] = receiver->raw[i];
    }
    receiver->frames++;
    return LGS_FRAME;
}

/* Take one byte from the line. `frame` is written only where LGS_FRAME is returned. */
static inline lgs_status lgs_receive(lgs_receiver *receiver, uint8_t byte, lgs_frame *frame)
{
    lgs_status status = LGS_PENDING;

    if (byte == 0u) {
        status = lgs_judge(receiver, frame);
        receiver->count = 0u;
        receiver->left = 0u;
        receiver->begun = 0u;
        receiver->skipping = 0u;
    } else if (receiver->skipping == 0u) {
        const uint8_t is_code = (uint8_t)((receiver->left == 0u) ? 1u : 0u);
        const uint8_t is_first = (uint8_t)((receiver->begun == 0u) ? 1u : 0u);
        if (is_first == 0u) {
            if (receiver->count >= LGS_MAX_RAW) {
                receiver->skipping = 1u;
                receiver->too_long++;
                status = LGS_LONG;
            } else {
                /* a code that is not the first stands for the zero before it */
                receiver->raw[receiver->count] = (is_code != 0u) ? (uint8_t)0u : byte;
                receiver->count++;
            }
        }
        receiver->left = (uint8_t)(((is_code != 0u) ? byte : receiver->left) - 1u);
        receiver->begun = 1u;
    } else {
        /* garbage: wait for the next zero */
    }
    return status;
}

#ifdef __cplusplus
}
#endif

#endif
