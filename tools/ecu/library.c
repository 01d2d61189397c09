/* The example ECU as a library, for `liftgate-hil ... --ecu liftgate-ecu.so`. It stands still until it is asked to move. */
#include "liftgate_ecu.h"

#include "ecu.h"

#include <stdlib.h>

void *liftgate_ecu_create(void)
{
    struct ecu *ecu = malloc(sizeof *ecu);

    if (ecu != NULL) {
        ecu_init(ecu);
    }
    return ecu;
}

void liftgate_ecu_destroy(void *ecu)
{
    free(ecu);
}

void liftgate_ecu_request(void *ecu, int action)
{
    ecu_request(ecu, action);
}

int liftgate_ecu_step(void *ecu, int64_t now_ns, const struct liftgate_frame *in, int count,
                      struct liftgate_frame *out, int capacity)
{
    return ecu_step(ecu, now_ns, in, count, out, capacity);
}
