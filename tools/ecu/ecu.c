/*
 * A small ECU for the emulated gate: opens it with a soft start, closes it again, and reverses where the motors'
 * current says that something is trapped. `ecu-can vcan0 [SECONDS]` or `ecu-serial /dev/ttyUSB0 [SECONDS]`.
 *
 * An example of the structure, not of a good anti-trap function: its current limit is a constant. The frames are
 * packed and unpacked by code that cantools makes of dbc/liftgate.dbc.
 *
 * Exit code: 0 opened and closed, or reversed; 1 not within SECONDS (default 60); 2 no such wire.
 */
#include "liftgate.h"
#include "wire.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define CYCLE 0.010 /* s */
#define CRUISE 450.0 /* Hall counts/s */
#define CREEP 90.0 /* counts/s, into the stops and the latch */
#define SOFT_START 0.6 /* s */
#define SOFT_STOP 400.0 /* counts */
#define RATED 620.0 /* counts/s at full duty without load */
#define SEAL 40 /* counts above closed: more current is no surprise here */
#define TRAP_CURRENT 3.0 /* A, mean of both motors */
#define TRAP_CYCLES 3
#define BLANKING 0.9 /* s after a start */
#define STILL 25.0 /* counts/s */
#define STALL_CYCLES 10
#define REVERSAL 800 /* counts */
#define PAUSE 0.5 /* s */
#define SPAN 4 /* cycles over which the speed is measured */

enum state { WAITING, OPENING, OPEN, CLOSING, REVERSING, DONE };
static const char *const names[] = {"waiting", "opening", "open", "closing", "reversing", "done"};

static struct {
    double current[2]; /* A, positive opens */
    int32_t count[2];
    bool latched;
    unsigned heard; /* bits: left, right, gate */
} gate;

static enum state state = WAITING;
static double since; /* s in this state */
static double integral;
static int32_t history[SPAN + 1];
static int32_t closed_at;
static int32_t started_at;
static int suspect, still;

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static uint8_t crc8_j1850(uint16_t id, const uint8_t *data, size_t length)
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

static void take(const struct wire_frame *frame)
{
    if (frame->id == LIFTGATE_LEFT_DRIVE_FRAME_ID || frame->id == LIFTGATE_RIGHT_DRIVE_FRAME_ID) {
        /* LeftDrive and RightDrive are laid out alike. */
        const unsigned side = frame->id == LIFTGATE_RIGHT_DRIVE_FRAME_ID;
        struct liftgate_left_drive_t drive;
        if (frame->length == LIFTGATE_LEFT_DRIVE_LENGTH
            && frame->data[7] == crc8_j1850((uint16_t)frame->id, frame->data, 7u)
            && liftgate_left_drive_unpack(&drive, frame->data, frame->length) == 0) {
            gate.current[side] = liftgate_left_drive_motor_current_decode(drive.motor_current);
            gate.count[side] = drive.hall_count;
            gate.heard |= 1u << side;
        }
    } else if (frame->id == LIFTGATE_GATE_FRAME_ID) {
        struct liftgate_gate_t sensed;
        if (frame->length == LIFTGATE_GATE_LENGTH
            && liftgate_gate_unpack(&sensed, frame->data, frame->length) == 0) {
            gate.latched = sensed.latch_state == LIFTGATE_GATE_LATCH_STATE_LATCHED_CHOICE;
            gate.heard |= 4u;
        }
    }
}

/* Signed duty of both motors, -1 to 1; 0 coasts. */
static void send_command(double duty, bool release)
{
    static uint8_t alive;
    struct liftgate_drive_command_t command = {0};
    uint8_t data[LIFTGATE_DRIVE_COMMAND_LENGTH];
    const uint8_t direction = duty > 0.0 ? LIFTGATE_DRIVE_COMMAND_LEFT_DIRECTION_OPEN_CHOICE
                            : duty < 0.0 ? LIFTGATE_DRIVE_COMMAND_LEFT_DIRECTION_CLOSE_CHOICE
                                         : LIFTGATE_DRIVE_COMMAND_LEFT_DIRECTION_COAST_CHOICE;

    command.left_duty = liftgate_drive_command_left_duty_encode(duty < 0.0 ? -100.0 * duty : 100.0 * duty);
    command.right_duty = command.left_duty;
    command.left_direction = direction;
    command.right_direction = direction;
    command.latch_release = release;
    command.alive_counter = alive++ & 0x0Fu;
    (void)liftgate_drive_command_pack(data, &command, sizeof data);
    data[7] = crc8_j1850(LIFTGATE_DRIVE_COMMAND_FRAME_ID, data, 7u);
    (void)wire_send(LIFTGATE_DRIVE_COMMAND_FRAME_ID, data, sizeof data);
}

static void enter(enum state next, int32_t position, double current, double start)
{
    fprintf(stderr, "%7.3f s  %s at %d counts, %.2f A\n", now() - start, names[next], (int)position, current);
    state = next;
    since = 0.0;
    integral = 0.0;
    suspect = still = 0;
    started_at = position;
}

/* One control cycle; the duty. */
static double control(double start)
{
    const double current = 0.5 * (gate.current[0] + gate.current[1]);
    const int32_t position = (gate.count[0] + gate.count[1]) / 2 - closed_at;
    memmove(history, history + 1, SPAN * sizeof history[0]);
    history[SPAN] = position;
    const double speed = (history[SPAN] - history[0]) / (SPAN * CYCLE);
    const double sign = state == CLOSING ? -1.0 : 1.0;

    since += CYCLE;
    still = sign * speed < STILL ? still + 1 : 0;
    suspect = sign * current > TRAP_CURRENT && position > SEAL ? suspect + 1 : 0;
    if (state == WAITING && since > SPAN * CYCLE) {
        closed_at = position;
        for (int i = 0; i <= SPAN; i++) {
            history[i] = 0;
        }
        enter(OPENING, 0, current, start);
    } else if (state == OPENING && since > SOFT_START && still > STALL_CYCLES) {
        enter(OPEN, position, current, start);
    } else if (state == OPEN && since > PAUSE) {
        enter(CLOSING, position, current, start);
    } else if (state == CLOSING && gate.latched) {
        enter(DONE, position, current, start);
    } else if (state == CLOSING && since > BLANKING && suspect >= TRAP_CYCLES) {
        enter(REVERSING, position, current, start);
    } else if (state == REVERSING && position - started_at > REVERSAL) {
        enter(DONE, position, current, start);
    }
    if (state != OPENING && state != CLOSING && state != REVERSING) {
        return 0.0;
    }
    /* Soft start over time, soft stop over the way that is left. */
    double wanted = CREEP + CRUISE * since / SOFT_START;
    wanted = wanted < CRUISE ? wanted : CRUISE;
    if (state == CLOSING && position < SOFT_STOP) {
        const double slow = CRUISE * (position - SEAL) / SOFT_STOP;
        wanted = slow > CREEP ? slow : CREEP;
    }
    const double way = state == CLOSING ? -1.0 : 1.0;
    const double error = wanted - way * speed;
    integral += 0.004 * error * CYCLE;
    const double duty = wanted / RATED + 0.0005 * error + integral;
    return way * (duty < 0.05 ? 0.05 : duty > 1.0 ? 1.0 : duty);
}

int main(int argc, char **argv)
{
    const double limit = argc > 2 ? atof(argv[2]) : 60.0;
    if (argc < 2 || !wire_open(argv[1])) {
        fprintf(stderr, "%s: %s\n", argv[0], argc < 2 ? "WIRE [SECONDS]" : strerror(errno));
        return 2;
    }
    const double start = now();
    double next = start;
    while (state != DONE && now() - start < limit) {
        struct wire_frame frame;
        const double left = next - now();
        if (left > 0.0) {
            if (wire_receive(&frame, 1 + (int)(1e3 * left))) {
                take(&frame);
            }
            continue;
        }
        next += CYCLE;
        const double duty = gate.heard == 7u ? control(start) : 0.0;
        send_command(duty, state == OPENING && gate.latched && since < 1.0);
    }
    send_command(0.0, false); /* motors off */
    wire_close();
    return state == DONE ? 0 : 1;
}
