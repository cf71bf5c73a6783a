/* NI's C interface as far as nifpga calls it, I: sessions, registers and interrupts. */
#include "driver.h"

#include <stdio.h>
#include <string.h>

#define RESOURCE "RIO0"

enum { OPEN_NO_RUN = 1 };
enum { CLOSE_NO_RESET_IF_LAST = 1 };
enum vi_state { NOT_RUNNING = 0, RUNNING = 2 };

static uint32_t last_session = 0x1000;

/* For the test's side: `status` instead of calls `skip` to `skip + times` of NiFpgaDll_`name`. */
EXPORT Status difffric_emulator_fail(const char *name, Status status, uint64_t skip, uint64_t times)
{
    Status found = OUT_OF_HANDLES;
    card_lock();
    for (int i = 0; i < FAILURES && found; i++)
        if (!card.failures[i].times) {
            card.failures[i] = (struct failure){"", status, skip, times};
            snprintf(card.failures[i].name, sizeof card.failures[i].name, "%s", name);
            found = SUCCESS;
        }
    card_unlock();
    return found;
}

static Status failure_of(const char *function)
{
    const char *name = function + strlen("NiFpgaDll_");
    for (int i = 0; i < FAILURES; i++) {
        struct failure *f = &card.failures[i];
        if (!f->times || strcmp(f->name, name))
            continue;
        if (f->skip) {
            f->skip--;
        } else {
            if (f->times != UINT64_MAX)
                f->times--;
            return f->status;
        }
    }
    return SUCCESS;
}

static uint32_t *place_of(uint32_t session)
{
    for (int i = 0; i < SESSIONS; i++)
        if (card.sessions[i] == session)
            return &card.sessions[i];
    return NULL;
}

Status enter(uint32_t session, const char *function)
{
    card_lock();
    card_advance();
    Status status = INVALID_SESSION;
    if (session && place_of(session)) {
        status = failure_of(function);
        if (status >= 0 && card.removed)
            status = HARDWARE_FAULT;
    }
    if (status < 0)
        card_unlock();
    return status;
}

Status leave(Status entered, Status status)
{
    card_unlock();
    return status ? status : entered;
}

int64_t deadline_of(uint32_t timeout)
{
    return timeout == INFINITE ? NEVER : card_now() + timeout * MILLISECOND;
}

/* Sessions */

EXPORT Status NiFpgaDll_Open(
    const char *bitfile, const char *signature, const char *resource, uint32_t attribute,
    uint32_t *session)
{
    card_lock();
    Status status = failure_of(__func__);
    uint32_t *place = place_of(0);
    FILE *file = fopen(bitfile, "rb");
    if (file)
        fclose(file);
    if (status < 0)
        ;
    else if (!file)
        status = BITFILE_READ_ERROR;
    else if (strcmp(resource, RESOURCE))
        status = RESOURCE_NOT_FOUND;
    else if (card.removed)
        status = HARDWARE_FAULT;
    else if (strcmp(signature, card.signature))
        status = SIGNATURE_MISMATCH;
    else if (!place)
        status = OUT_OF_HANDLES;
    else {
        *session = *place = ++last_session;
        card.running |= !(attribute & OPEN_NO_RUN);
    }
    return leave(SUCCESS, status);
}

EXPORT Status NiFpgaDll_Close(uint32_t session, uint32_t attribute)
{
    card_lock();
    card_advance();
    uint32_t *place = session ? place_of(session) : NULL;
    Status status = place ? failure_of(__func__) : INVALID_SESSION;
    if (place) {
        *place = 0; /* closed in any case */
        if (!status && card.removed)
            status = HARDWARE_FAULT;
        bool last = true;
        for (int i = 0; i < SESSIONS; i++)
            last &= !card.sessions[i];
        for (int i = 0; i < FIFOS && last; i++) {
            if (!status && card.fifos[i].outstanding_regions)
                status = REGIONS_OUTSTANDING;
            fifo_stop(&card.fifos[i]);
        }
        if (last && !(attribute & CLOSE_NO_RESET_IF_LAST))
            card_reset();
    }
    return leave(SUCCESS, status);
}

EXPORT Status NiFpgaDll_Run(uint32_t session, uint32_t attribute)
{
    (void)attribute; /* nothing here ever ends by itself */
    ENTER(session);
    Status status = card.running ? FPGA_ALREADY_RUNNING : SUCCESS;
    card.running = true;
    return leave(entered, status);
}

/* All three end the push and stop the FIFOs. */
#define DEFINE_STOP(Name) \
    EXPORT Status NiFpgaDll_##Name(uint32_t session) \
    { \
        ENTER(session); \
        card_reset(); \
        return leave(entered, SUCCESS); \
    }
DEFINE_STOP(Reset)
DEFINE_STOP(Abort)
DEFINE_STOP(Download)

EXPORT Status NiFpgaDll_GetFpgaViState(uint32_t session, uint32_t *state)
{
    ENTER(session);
    *state = card.running ? RUNNING : NOT_RUNNING;
    return leave(entered, SUCCESS);
}

/* Registers */

static int register_at(uint32_t address, enum type type)
{
    for (int i = 0; i < REGISTERS; i++)
        if (register_table[i].address == address && register_table[i].type == type)
            return i;
    return -1;
}

static Status read_register(enum type type, uint32_t address, int64_t *value)
{
    int i = register_at(address, type);
    if (i < 0)
        return INVALID_PARAMETER;
    card_look();
    *value = card.value[i];
    return card.removed ? HARDWARE_FAULT : SUCCESS;
}

static Status write_register(enum type type, uint32_t address, int64_t value)
{
    int i = register_at(address, type);
    if (i < 0 || register_table[i].kind != CONTROL)
        return INVALID_PARAMETER;
    bool starts = i == REG_START && value && !card.value[i]; /* an edge, as the core takes it */
    card.value[i] = type == TYPE_Bool ? value != 0 : value;
    if (starts)
        card_begin_push();
    return SUCCESS;
}

/* No register is an array: one element is all that can be read or written as one. */
#define DEFINE_REGISTER(Name, ctype) \
    EXPORT Status NiFpgaDll_Read##Name(uint32_t session, uint32_t indicator, ctype *value) \
    { \
        ENTER(session); \
        int64_t read = 0; \
        Status status = read_register(TYPE_##Name, indicator, &read); \
        *value = (ctype)read; \
        return leave(entered, status); \
    } \
    EXPORT Status NiFpgaDll_Write##Name(uint32_t session, uint32_t control, ctype value) \
    { \
        ENTER(session); \
        return leave(entered, write_register(TYPE_##Name, control, (int64_t)value)); \
    } \
    EXPORT Status NiFpgaDll_ReadArray##Name( \
        uint32_t session, uint32_t indicator, ctype *array, size_t size) \
    { \
        ENTER(session); \
        int64_t read = 0; \
        Status status = INVALID_PARAMETER; \
        if (size == 1) { \
            status = read_register(TYPE_##Name, indicator, &read); \
            *array = (ctype)read; \
        } \
        return leave(entered, status); \
    } \
    EXPORT Status NiFpgaDll_WriteArray##Name( \
        uint32_t session, uint32_t control, const ctype *array, size_t size) \
    { \
        ENTER(session); \
        Status status = INVALID_PARAMETER; \
        if (size == 1) \
            status = write_register(TYPE_##Name, control, (int64_t)*array); \
        return leave(entered, status); \
    }

EXPORT Status NiFpgaDll_FindRegisterPrivate(
    uint32_t session, const char *name, uint32_t type, uint32_t *address)
{
    (void)type; /* NI's codes, which nifpga does not give */
    ENTER(session);
    Status status = RESOURCE_NOT_FOUND;
    for (int i = 0; i < REGISTERS && status; i++)
        if (!strcmp(register_table[i].name, name)) {
            *address = register_table[i].address;
            status = SUCCESS;
        }
    return leave(entered, status);
}

/* Interrupts */

EXPORT Status NiFpgaDll_ReserveIrqContext(uint32_t session, void **context)
{
    ENTER(session);
    Status status = OUT_OF_HANDLES;
    for (int i = 0; i < CONTEXTS && status; i++)
        if (!card.contexts[i]) {
            card.contexts[i] = true;
            *context = &card.contexts[i];
            status = SUCCESS;
        }
    return leave(entered, status);
}

static bool is_reserved(const bool *context)
{
    return context >= card.contexts && context < card.contexts + CONTEXTS && *context;
}

EXPORT Status NiFpgaDll_UnreserveIrqContext(uint32_t session, void *context)
{
    ENTER(session);
    bool reserved = is_reserved(context);
    if (reserved)
        *(bool *)context = false;
    return leave(entered, reserved ? SUCCESS : INVALID_PARAMETER);
}

/* A time-out is no error: `timed_out` says so. */
EXPORT Status NiFpgaDll_WaitOnIrqs(
    uint32_t session, void *context, uint32_t irqs, uint32_t timeout, uint32_t *asserted,
    uint8_t *timed_out)
{
    ENTER(session);
    Status status = is_reserved(context) ? SUCCESS : INVALID_PARAMETER;
    if (!timeout)
        card_look();
    int64_t deadline = deadline_of(timeout);
    while (!status && !(card.irqs & irqs) && card_now() < deadline) {
        if (!card_wait(card.push ? card.push->total : 0, deadline))
            break;
        card_advance();
        if (card.removed)
            status = HARDWARE_FAULT;
    }
    if (asserted)
        *asserted = card.irqs & irqs;
    if (timed_out)
        *timed_out = !(card.irqs & irqs);
    return leave(entered, status);
}

EXPORT Status NiFpgaDll_AcknowledgeIrqs(uint32_t session, uint32_t irqs)
{
    ENTER(session);
    card.irqs &= ~irqs;
    return leave(entered, SUCCESS);
}
FOR_EACH_SCALAR(DEFINE_REGISTER)

DEFINE_UNSUPPORTED(OpenResource)
DEFINE_UNSUPPORTED(AddResources)
DEFINE_UNSUPPORTED(ClientFunctionCall)

/* These have no session. */
EXPORT Status NiFpgaDll_GetResourceIndex(void) { return FEATURE_NOT_SUPPORTED; }
EXPORT Status NiFpgaDll_ReleaseResourceIndex(void) { return FEATURE_NOT_SUPPORTED; }
EXPORT Status NiFpgaDll_GetResourceName(void) { return FEATURE_NOT_SUPPORTED; }
