/* The ECU `Echo` of echo_ecu.py, all of it in file statics. Where LIFTGATE_TEST_NOTES names a file, that gets a
 * line when the ECU is made and when it ends. */
#include "liftgate_ecu.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static uint32_t steps;
static int requests[16], requested;

static void note(const char *text)
{
    const char *name = getenv("LIFTGATE_TEST_NOTES");
    FILE *file = name != NULL ? fopen(name, "a") : NULL;

    if (file != NULL) {
        fprintf(file, "%s\n", text);
        fclose(file);
    }
}

static struct liftgate_frame frame_of(uint32_t id, int64_t value, uint8_t length)
{
    struct liftgate_frame frame = {0};

    frame.id = id;
    frame.length = length;
    for (int i = 0; i < length; i++) {
        frame.data[i] = (uint8_t)(value >> (8 * i));
    }
    return frame;
}

void *liftgate_ecu_create(void)
{
    note("created");
    return &steps;
}

void liftgate_ecu_destroy(void *ecu)
{
    note(ecu == &steps ? "destroyed" : "destroyed another");
}

void liftgate_ecu_request(void *ecu, int action)
{
    if (ecu == &steps && requested < 16) {
        requests[requested++] = action;
    }
}

int liftgate_ecu_step(void *ecu, int64_t now_ns, const struct liftgate_frame *in, int count,
                      struct liftgate_frame *out, int capacity)
{
    int sent = 0;

    if (ecu != &steps || capacity != 1024) {
        return -1;
    }
    for (int i = 0; i < count; i++) {
        out[sent] = in[i];
        out[sent++].id |= LIFTGATE_ID_EXTENDED;
    }
    for (int i = 0; i < requested; i++) {
        out[sent++] = frame_of(0x700u + (uint32_t)requests[i], now_ns, 8);
    }
    requested = 0;
    if (now_ns == 0) {
        out[sent++] = frame_of(0x6F0u, steps, 4);
    }
    steps++;
    return sent;
}
