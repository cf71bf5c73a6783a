/* What the entry points share. Each of them stands between `enter` and `leave`, which hold the lock.
 *
 * Stricter than NI's driver: a register is accessed by its own type only, and an indicator is not
 * written.
 */
#pragma once

#include "card.h"

#define MILLISECOND 1000000LL
#define INFINITE 0xFFFFFFFFu
#define MIN(a, b) ((a) < (b) ? (a) : (b))

/* `entered` is what was injected: an error instead of the call, or a warning with it. */
Status enter(uint32_t session, const char *function);
Status leave(Status entered, Status status);
#define ENTER(session) \
    Status entered = enter(session, __func__); \
    if (entered < 0) \
        return entered

int64_t deadline_of(uint32_t timeout);

/* For what nifpga binds and this card has no use for. The further arguments stay unread. */
#define DEFINE_UNSUPPORTED(Name) \
    EXPORT Status NiFpgaDll_##Name(uint32_t session) \
    { \
        ENTER(session); \
        return leave(entered, FEATURE_NOT_SUPPORTED); \
    }

#define FOR_EACH_SCALAR(DEFINE) \
    DEFINE(Bool, uint8_t) \
    DEFINE(I8, int8_t) \
    DEFINE(U8, uint8_t) \
    DEFINE(I16, int16_t) \
    DEFINE(U16, uint16_t) \
    DEFINE(I32, int32_t) \
    DEFINE(U32, uint32_t) \
    DEFINE(I64, int64_t) \
    DEFINE(U64, uint64_t) \
    DEFINE(Sgl, float) \
    DEFINE(Dbl, double)
