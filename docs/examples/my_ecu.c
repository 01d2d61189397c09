/* The smallest ECU in C: opens and closes the gate when it is asked to, without looking at anything.
 *
 *     cc -shared -fPIC -fvisibility=hidden -I"$(python -c 'import liftgate_hil as l; print(l.__path__[0])')/ecu" \
 *         -o c_ecu.so my_ecu.c
 *
 * An ECU that listens, and reverses: tools/ecu.
 */
#include "liftgate_ecu.h"

#include <string.h>

enum { COAST, OPEN, CLOSE }; /* DriveCommand.LeftDirection, see dbc/liftgate.dbc */

static int direction = COAST; /* statics are fine: each episode has a process of its own */
static int64_t next_ns;
static uint8_t alive;

static uint8_t crc8_j1850(const uint8_t *data, size_t length)
{
    uint8_t crc = 0xFFu;

    while (length-- > 0u) {
        crc ^= *data++;
        for (int bit = 0; bit < 8; bit++) {
            crc = (uint8_t)((crc & 0x80u) ? (crc << 1) ^ 0x1D : crc << 1);
        }
    }
    return crc ^ 0xFFu;
}

void *liftgate_ecu_create(void)
{
    return &alive; /* anything but NULL */
}

void liftgate_ecu_destroy(void *ecu)
{
    (void)ecu;
}

void liftgate_ecu_request(void *ecu, int action)
{
    (void)ecu;
    direction = action == LIFTGATE_REQUEST_OPEN ? OPEN : action == LIFTGATE_REQUEST_CLOSE ? CLOSE : COAST;
}

int liftgate_ecu_step(void *ecu, int64_t now_ns, const struct liftgate_frame *in, int count,
                      struct liftgate_frame *out, int capacity)
{
    const unsigned duty = direction == COAST ? 0u : 600u; /* 0.1 % */
    uint8_t checked[9] = {0x20u, 0x01u};                  /* identifier, then the payload without its checksum */
    uint8_t *payload = checked + 2;

    (void)ecu, (void)in, (void)count;
    if (now_ns < next_ns || capacity < 1) {
        return 0;
    }
    next_ns = now_ns + 10000000; /* DriveCommand comes every 10 ms */
    payload[0] = (uint8_t)duty;  /* LeftDuty: 10 bits from bit 0; RightDuty: 10 from bit 10 */
    payload[1] = (uint8_t)(duty >> 8 | duty << 2);
    payload[2] = (uint8_t)(duty >> 6 | (unsigned)direction << 4 | (unsigned)direction << 6);
    payload[3] = direction == OPEN; /* LatchRelease */
    payload[6] = alive++ & 0x0Fu;   /* AliveCounter */
    memset(out, 0, sizeof *out);
    out->id = 0x120u;
    out->length = 8u;
    memcpy(out->data, payload, 7u);
    out->data[7] = crc8_j1850(checked, sizeof checked);
    return 1;
}
