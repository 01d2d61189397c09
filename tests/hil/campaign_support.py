"""What several tests of campaigns share: a scenario of one second, and an ECU in C that sends nothing."""

from __future__ import annotations

SHORT = """
duration = 1.0
initial = "open"

[parameters]
angle = 75
rod = 10_000

[[request]]
time = 0.1
action = "close"

[[obstacle]]
angle_deg = "$angle"
stiffness = "$rod"

[[expect]]
name = "stays open"
always = "gate_angle_deg > $angle"
"""
_SILENT_ECU = """
#include <signal.h>
#include <stdlib.h>
#include <unistd.h>
#include "liftgate_ecu.h"
static int steps;
void *liftgate_ecu_create(void) { return &steps; }
void liftgate_ecu_destroy(void *ecu) { (void)ecu; }
int liftgate_ecu_step(void *ecu, int64_t now_ns, const struct liftgate_frame *in, int count,
                      struct liftgate_frame *out, int capacity)
{
    (void)ecu; (void)now_ns; (void)in; (void)count; (void)out; (void)capacity;
    ++steps;
    EACH_STEP
    return 0;
}
"""


def silent_ecu(each_step: str = "") -> str:
    """Return the source of an ECU that sends nothing; `each_step` is what it does in each of its `steps`."""
    return _SILENT_ECU.replace("EACH_STEP", each_step)
