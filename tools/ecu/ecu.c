/*
 * A small ECU for the emulated gate: opens and closes it with a soft start when asked to, and reverses where the
 * motors' current says that something is trapped.
 *
 * An example of the structure, not of a good anti-trap function: its current limit is a constant. The frames are
 * packed and unpacked by code that cantools makes of dbc/liftgate.dbc.
 */
#include "ecu.h"

#include "liftgate.h"

#include <stddef.h>
#include <string.h>

#define CYCLE (1e-9 * (double)ECU_CYCLE_NS) /* s */
#define CRUISE 450.0 /* Hall counts/s */
#define CREEP 90.0 /* counts/s, into the stops and the latch */
#define SOFT_START 0.6 /* s */
#define SOFT_STOP 400.0 /* counts */
#define RATED 620.0 /* counts/s at full duty without load */
#define RELEASE 1.0 /* s, at most, that the latch is driven */
#define SEAL 40 /* counts above closed: more current is no surprise here */
#define TRAP_CURRENT 3.0 /* A, mean of both motors */
#define TRAP_CYCLES 3
#define BLANKING 0.9 /* s after a start */
#define STILL 25.0 /* counts/s */
#define STALL_CYCLES 10
#define REVERSAL 800 /* counts */

enum { NO_REQUEST = -1 };
enum { HEARD_GATE = 4, HEARD_ALL = 7 };

static uint8_t crc8_j1850(uint32_t id, const uint8_t *data, size_t length)
{
    uint8_t crc = 0xFFu;
    for (size_t i = 0; i < length + 2u; i++) {
        crc ^= i == 0u ? (uint8_t)(id & 0xFFu) : i == 1u ? (uint8_t)(id >> 8) : data[i - 2u];
        for (int bit = 0; bit < 8; bit++) {
            crc = (uint8_t)((crc & 0x80u) ? (crc << 1) ^ 0x1D : crc << 1);
        }
    }
    return crc ^ 0xFFu;
}

static void take(struct ecu *ecu, const struct liftgate_frame *frame)
{
    if (frame->flags != 0u) { /* this bus has no CAN FD */
        return;
    }
    /* The whole id is compared, with its flags, so that no extended, remote or error frame looks like one of ours. */
    if (frame->id == LIFTGATE_LEFT_DRIVE_FRAME_ID || frame->id == LIFTGATE_RIGHT_DRIVE_FRAME_ID) {
        /* LeftDrive and RightDrive are laid out alike. */
        const unsigned side = frame->id == LIFTGATE_RIGHT_DRIVE_FRAME_ID;
        struct liftgate_left_drive_t drive;
        if (frame->length == LIFTGATE_LEFT_DRIVE_LENGTH && frame->data[7] == crc8_j1850(frame->id, frame->data, 7u)
            && liftgate_left_drive_unpack(&drive, frame->data, frame->length) == 0) {
            ecu->currents[side] = liftgate_left_drive_motor_current_decode(drive.motor_current);
            ecu->counts[side] = drive.hall_count;
            ecu->heard |= 1u << side;
        }
    } else if (frame->id == LIFTGATE_GATE_FRAME_ID) {
        struct liftgate_gate_t sensed;
        if (frame->length == LIFTGATE_GATE_LENGTH
            && liftgate_gate_unpack(&sensed, frame->data, frame->length) == 0) {
            ecu->latched = sensed.latch_state == LIFTGATE_GATE_LATCH_STATE_LATCHED_CHOICE;
            ecu->heard |= HEARD_GATE;
        }
    }
}

/* Signed duty of both motors, -1 to 1; 0 coasts. */
static void command(struct ecu *ecu, double duty, bool release, struct liftgate_frame *out)
{
    struct liftgate_drive_command_t command = {0};
    const uint8_t direction = duty > 0.0 ? LIFTGATE_DRIVE_COMMAND_LEFT_DIRECTION_OPEN_CHOICE
                            : duty < 0.0 ? LIFTGATE_DRIVE_COMMAND_LEFT_DIRECTION_CLOSE_CHOICE
                                         : LIFTGATE_DRIVE_COMMAND_LEFT_DIRECTION_COAST_CHOICE;

    command.left_duty = liftgate_drive_command_left_duty_encode(duty < 0.0 ? -100.0 * duty : 100.0 * duty);
    command.right_duty = command.left_duty;
    command.left_direction = direction;
    command.right_direction = direction;
    command.latch_release = release;
    command.alive_counter = ecu->alive++ & 0x0Fu;
    memset(out, 0, sizeof *out);
    out->id = LIFTGATE_DRIVE_COMMAND_FRAME_ID;
    out->length = LIFTGATE_DRIVE_COMMAND_LENGTH;
    (void)liftgate_drive_command_pack(out->data, &command, sizeof out->data);
    out->data[7] = crc8_j1850(out->id, out->data, 7u);
}

static double elapsed(const struct ecu *ecu, int64_t now_ns)
{
    return 1e-9 * (double)(now_ns - ecu->since_ns);
}

static bool is_moving(const struct ecu *ecu)
{
    return ecu->mode == ECU_OPENING || ecu->mode == ECU_CLOSING || ecu->mode == ECU_REVERSING;
}

static void enter(struct ecu *ecu, enum ecu_mode next, int64_t now_ns)
{
    ecu->mode = next;
    ecu->since_ns = now_ns;
    ecu->started_at = ecu->position;
    ecu->integral = 0.0;
    ecu->suspect = ecu->still = 0;
}

static void measure(struct ecu *ecu, int64_t now_ns)
{
    const int32_t count = (ecu->counts[0] + ecu->counts[1]) / 2;

    if (!ecu->measured) {
        for (int i = 0; i <= ECU_SPAN; i++) {
            ecu->history[i].count = count;
            ecu->history[i].time_ns = now_ns;
        }
        ecu->measured = true;
        ecu->since_ns = now_ns;
    }
    memmove(ecu->history, ecu->history + 1, ECU_SPAN * sizeof ecu->history[0]);
    ecu->history[ECU_SPAN].count = count;
    ecu->history[ECU_SPAN].time_ns = now_ns;
    /* Its own times, because a cycle begins with a tick and ticks needn't divide it. */
    const double span = 1e-9 * (double)(now_ns - ecu->history[0].time_ns);
    ecu->speed = span > 0.0 ? (count - ecu->history[0].count) / span : 0.0;
    ecu->current = 0.5 * (ecu->currents[0] + ecu->currents[1]);
    ecu->position = count - ecu->closed_at;
}

/* The gate is home: counts begin here. */
static void come_home(struct ecu *ecu, int64_t now_ns)
{
    enter(ecu, ECU_CLOSED, now_ns);
    ecu->closed_at = ecu->history[ECU_SPAN].count;
    ecu->position = 0;
}

/* What the gate does by itself: ends of motions, and the trap. */
static void watch(struct ecu *ecu, int64_t now_ns)
{
    const double way = ecu->mode == ECU_CLOSING ? -1.0 : 1.0;
    const double since = elapsed(ecu, now_ns);

    if (is_moving(ecu)) {
        ecu->still = way * ecu->speed < STILL ? ecu->still + 1 : 0;
        ecu->suspect = way * ecu->current > TRAP_CURRENT && ecu->position > SEAL ? ecu->suspect + 1 : 0;
    }
    const bool stalled = since > SOFT_START && ecu->still > STALL_CYCLES;
    if (ecu->mode == ECU_WAITING && since > ECU_SPAN * CYCLE) {
        if (ecu->latched) {
            come_home(ecu, now_ns);
        } else { /* found ajar: the bus counts from closed */
            enter(ecu, ECU_STOPPED, now_ns);
        }
    } else if (ecu->mode == ECU_OPENING && stalled) {
        enter(ecu, ECU_OPEN, now_ns);
    } else if (ecu->mode == ECU_CLOSING && ecu->latched) {
        come_home(ecu, now_ns);
    } else if (ecu->mode == ECU_CLOSING && since > BLANKING && ecu->suspect >= TRAP_CYCLES) {
        enter(ecu, ECU_REVERSING, now_ns);
    } else if (ecu->mode == ECU_REVERSING && (ecu->position - ecu->started_at > REVERSAL || stalled)) {
        enter(ecu, ECU_STOPPED, now_ns);
    }
}

static void obey(struct ecu *ecu, int64_t now_ns)
{
    if (ecu->mode == ECU_WAITING) {
        return;
    }
    if (ecu->pending == LIFTGATE_REQUEST_STOP && is_moving(ecu)) {
        enter(ecu, ECU_STOPPED, now_ns);
    } else if (ecu->pending == LIFTGATE_REQUEST_OPEN && ecu->mode != ECU_OPEN && ecu->mode != ECU_OPENING) {
        enter(ecu, ECU_OPENING, now_ns);
    } else if (ecu->pending == LIFTGATE_REQUEST_CLOSE /* but not onto what it is just backing away from */
               && (ecu->mode == ECU_STOPPED || ecu->mode == ECU_OPENING || ecu->mode == ECU_OPEN)) {
        enter(ecu, ECU_CLOSING, now_ns);
    }
    ecu->pending = NO_REQUEST;
}

/* The duty of this cycle. */
static double drive(struct ecu *ecu, int64_t now_ns)
{
    if (!is_moving(ecu)) {
        return 0.0;
    }
    /* Soft start over time, soft stop over the way that is left. */
    double wanted = CREEP + CRUISE * elapsed(ecu, now_ns) / SOFT_START;
    wanted = wanted < CRUISE ? wanted : CRUISE;
    if (ecu->mode == ECU_CLOSING && ecu->position < SOFT_STOP) {
        const double slow = CRUISE * (ecu->position - SEAL) / SOFT_STOP;
        wanted = slow > CREEP ? slow : CREEP;
    }
    const double way = ecu->mode == ECU_CLOSING ? -1.0 : 1.0;
    const double error = wanted - way * ecu->speed;
    ecu->integral += 0.004 * error * CYCLE;
    const double duty = wanted / RATED + 0.0005 * error + ecu->integral;
    return way * (duty < 0.05 ? 0.05 : duty > 1.0 ? 1.0 : duty);
}

void ecu_init(struct ecu *ecu)
{
    memset(ecu, 0, sizeof *ecu);
    ecu->mode = ECU_WAITING;
    ecu->pending = NO_REQUEST;
}

void ecu_request(struct ecu *ecu, int action)
{
    if (action == LIFTGATE_REQUEST_STOP || action == LIFTGATE_REQUEST_OPEN || action == LIFTGATE_REQUEST_CLOSE) {
        ecu->pending = action;
    }
}

int ecu_step(struct ecu *ecu, int64_t now_ns, const struct liftgate_frame *in, int count, struct liftgate_frame *out,
             int capacity)
{
    for (int i = 0; i < count; i++) {
        take(ecu, &in[i]);
    }
    if (!ecu->started) {
        ecu->started = true;
        ecu->due_ns = now_ns;
    }
    if (now_ns < ecu->due_ns) {
        return 0;
    }
    ecu->due_ns += ECU_CYCLE_NS * (1 + (now_ns - ecu->due_ns) / ECU_CYCLE_NS);
    double duty = 0.0;
    if (ecu->heard == HEARD_ALL) {
        measure(ecu, now_ns);
        watch(ecu, now_ns);
        obey(ecu, now_ns);
        duty = drive(ecu, now_ns);
    }
    if (capacity < 1) { /* lost, as on a bus that takes no frame; the next one's counter goes on from the last sent */
        return 0;
    }
    command(ecu, duty, ecu->mode == ECU_OPENING && ecu->latched && elapsed(ecu, now_ns) < RELEASE, out);
    return 1;
}

void ecu_motors_off(struct ecu *ecu, struct liftgate_frame *out)
{
    command(ecu, 0.0, false, out);
}
