/* NI's C interface as far as nifpga calls it, II: FIFOs, all of them from the card to the host. */
#include "driver.h"

#include <stdlib.h>
#include <string.h>

static size_t available(const struct fifo *fifo) { return fifo->put - fifo->got; }
static size_t acquired(const struct fifo *fifo) { return fifo->got - fifo->freed; }

static Status configure(uint32_t number, size_t requested, size_t *actual)
{
    if (number >= FIFOS)
        return INVALID_PARAMETER;
    struct fifo *fifo = &card.fifos[number];
    if (acquired(fifo))
        return ELEMENTS_CURRENTLY_ACQUIRED;
    if (!requested)
        return BAD_DEPTH;
    size_t unit = fifo->granularity;
    fifo_stop(fifo);
    free(fifo->ring);
    fifo->ring = NULL; /* made at the start */
    fifo->depth = (requested + unit - 1) / unit * unit;
    if (actual)
        *actual = fifo->depth;
    return SUCCESS;
}

static Status start(uint32_t number)
{
    if (number >= FIFOS)
        return INVALID_PARAMETER;
    struct fifo *fifo = &card.fifos[number];
    if (!fifo->ring)
        fifo->ring = calloc(fifo->depth, fifo_table[number].bytes);
    if (!fifo->ring)
        return MEMORY_FULL;
    fifo->started = true;
    return SUCCESS;
}

static Status stop(uint32_t number)
{
    if (number >= FIFOS)
        return INVALID_PARAMETER;
    if (acquired(&card.fifos[number]))
        return ELEMENTS_CURRENTLY_ACQUIRED;
    fifo_stop(&card.fifos[number]);
    return SUCCESS;
}

/* Wait until `n` elements can be got; on a time-out none has been. */
static Status wait_for(struct fifo *fifo, size_t n, uint32_t timeout)
{
    int64_t deadline = deadline_of(timeout);
    if (!n || (!timeout && available(fifo) < n))
        card_look();
    while (!card.removed && available(fifo) < n) {
        if (card_now() >= deadline)
            return FIFO_TIMEOUT;
        if (!card_wait(card.value[REG_SAMPLES] + n - available(fifo), deadline))
            return FIFO_TIMEOUT;
        card_advance();
    }
    return card.removed ? HARDWARE_FAULT : SUCCESS;
}

static Status read_fifo(
    enum type type, uint32_t number, void *data, size_t n, uint32_t timeout, size_t *remaining)
{
    if (number >= FIFOS || fifo_table[number].type != type)
        return INVALID_PARAMETER;
    struct fifo *fifo = &card.fifos[number];
    size_t bytes = fifo_table[number].bytes;
    if (acquired(fifo))
        return ELEMENTS_CURRENTLY_ACQUIRED;
    if (n > fifo->depth)
        return BAD_READ_WRITE_COUNT;
    Status status = start(number); /* as a FIFO that is read starts by itself */
    if (!status)
        status = wait_for(fifo, n, timeout);
    for (size_t done = 0, part; !status && done < n; done += part, fifo->got += part) {
        size_t at = fifo->got % fifo->depth;
        part = MIN(n - done, fifo->depth - at);
        memcpy((uint8_t *)data + done * bytes, fifo->ring + at * bytes, part * bytes);
    }
    fifo->freed = fifo->got;
    if (remaining)
        *remaining = available(fifo);
    return status;
}

/* As NI's driver does, wait only for what can be handed out in one piece, up to the ring's end. */
static Status acquire(
    uint32_t number, void **elements, size_t n, uint32_t timeout, size_t *got, size_t *remaining)
{
    struct fifo *fifo = &card.fifos[number];
    if (n > fifo->depth)
        return BAD_READ_WRITE_COUNT;
    size_t at = fifo->got % fifo->depth;
    n = MIN(n, fifo->depth - at);
    if (n + acquired(fifo) > fifo->depth)
        return NOT_PERMISSIBLE_TO_BE_ACQUIRED;
    Status status = start(number);
    if (!status)
        status = wait_for(fifo, n, timeout);
    if (!status)
        fifo->got += n;
    *got = status ? 0 : n;
    *elements = fifo->ring + at * fifo_table[number].bytes;
    if (remaining)
        *remaining = available(fifo);
    return status;
}

#define DEFINE_FIFO(Name, ctype) \
    EXPORT Status NiFpgaDll_ReadFifo##Name( \
        uint32_t session, uint32_t fifo, ctype *data, size_t n, uint32_t timeout, \
        size_t *remaining) \
    { \
        ENTER(session); \
        return leave(entered, read_fifo(TYPE_##Name, fifo, data, n, timeout, remaining)); \
    } \
    EXPORT Status NiFpgaDll_AcquireFifoReadElements##Name( \
        uint32_t session, uint32_t fifo, ctype **elements, size_t n, uint32_t timeout, \
        size_t *acquired, size_t *remaining) \
    { \
        ENTER(session); \
        Status status = INVALID_PARAMETER; \
        if (fifo < FIFOS && fifo_table[fifo].type == TYPE_##Name) \
            status = card.fifos[fifo].outstanding_regions \
                ? ELEMENTS_CURRENTLY_ACQUIRED \
                : acquire(fifo, (void **)elements, n, timeout, acquired, remaining); \
        return leave(entered, status); \
    }

EXPORT Status NiFpgaDll_ReleaseFifoElements(uint32_t session, uint32_t number, size_t n)
{
    ENTER(session);
    Status status = INVALID_PARAMETER;
    if (number < FIFOS) {
        struct fifo *fifo = &card.fifos[number];
        bool may = n <= acquired(fifo) && !fifo->outstanding_regions;
        status = may ? SUCCESS : BAD_READ_WRITE_COUNT;
        if (may)
            fifo->freed += n;
    }
    return leave(entered, status);
}

EXPORT Status NiFpgaDll_AcquireFifoReadRegion(
    uint32_t session, uint32_t number, void **region, void **elements, bool is_signed,
    uint32_t bytes, size_t n, uint32_t timeout, size_t *got, size_t *remaining)
{
    (void)is_signed;
    ENTER(session);
    if (number >= FIFOS || fifo_table[number].bytes != bytes)
        return leave(entered, INVALID_PARAMETER);
    struct fifo *fifo = &card.fifos[number];
    if (acquired(fifo) && !fifo->outstanding_regions)
        return leave(entered, ELEMENTS_CURRENTLY_ACQUIRED);
    if (fifo->outstanding_regions == REGIONS)
        return leave(entered, OUT_OF_FIFO_REGIONS);
    Status status = acquire(number, elements, n, timeout, got, remaining);
    *region = NULL;
    if (!status && *got) {
        unsigned last = (fifo->oldest_region + fifo->outstanding_regions++) % REGIONS;
        fifo->regions[last] = (struct region){*got, false};
        *region = &fifo->regions[last];
    }
    return leave(entered, status);
}

/* In any order; the card gets the elements back in the order in which it wrote them. */
EXPORT Status NiFpgaDll_ReleaseFifoRegion(uint32_t session, uint32_t number, void *region)
{
    ENTER(session);
    if (!region) /* a region of no elements */
        return leave(entered, SUCCESS);
    Status status = INVALID_PARAMETER;
    struct fifo *fifo = &card.fifos[number < FIFOS ? number : 0];
    for (unsigned i = 0; i < fifo->outstanding_regions && number < FIFOS; i++) {
        struct region *one = &fifo->regions[(fifo->oldest_region + i) % REGIONS];
        if (one == region && !one->released) {
            one->released = true;
            status = SUCCESS;
        }
    }
    while (fifo->outstanding_regions && fifo->regions[fifo->oldest_region].released) {
        fifo->freed += fifo->regions[fifo->oldest_region].elements;
        fifo->oldest_region = (fifo->oldest_region + 1) % REGIONS;
        fifo->outstanding_regions--;
    }
    return leave(entered, status);
}

EXPORT Status NiFpgaDll_ConfigureFifo2(
    uint32_t session, uint32_t fifo, size_t requested, size_t *actual)
{
    ENTER(session);
    return leave(entered, configure(fifo, requested, actual));
}

EXPORT Status NiFpgaDll_ConfigureFifo(uint32_t session, uint32_t fifo, size_t depth)
{
    ENTER(session);
    return leave(entered, configure(fifo, depth, NULL));
}

EXPORT Status NiFpgaDll_StartFifo(uint32_t session, uint32_t fifo)
{
    ENTER(session);
    return leave(entered, start(fifo));
}

EXPORT Status NiFpgaDll_StopFifo(uint32_t session, uint32_t fifo)
{
    ENTER(session);
    return leave(entered, stop(fifo));
}

EXPORT Status NiFpgaDll_UnreserveFifo(uint32_t session, uint32_t fifo)
{
    ENTER(session);
    return leave(entered, stop(fifo));
}

/* What was set counts at once. */
EXPORT Status NiFpgaDll_CommitFifoConfiguration(uint32_t session, uint32_t fifo)
{
    ENTER(session);
    return leave(entered, fifo < FIFOS ? SUCCESS : INVALID_PARAMETER);
}

EXPORT Status NiFpgaDll_FindFifoPrivate(
    uint32_t session, const char *name, uint32_t type, uint32_t *number)
{
    (void)type;
    ENTER(session);
    Status status = RESOURCE_NOT_FOUND;
    for (uint32_t i = 0; i < FIFOS && status; i++)
        if (!strcmp(fifo_table[i].name, name)) {
            *number = i;
            status = SUCCESS;
        }
    return leave(entered, status);
}

/* nifpga's FifoProperty */
enum property {
    BYTES_PER_ELEMENT = 1,
    GRANULARITY_ELEMENTS,
    BUFFER_SIZE_ELEMENTS,
    MIRRORED_ELEMENTS,
    DMA_BUFFER_TYPE,
    DMA_BUFFER,
    FLOW_CONTROL,
    ELEMENTS_ACQUIRED,
    PREFERRED_NUMA_NODE,
};

static Status get_property(uint32_t number, uint32_t property, uint64_t *value)
{
    if (number >= FIFOS)
        return INVALID_PARAMETER;
    struct fifo *fifo = &card.fifos[number];
    switch (property) {
    case BYTES_PER_ELEMENT: *value = fifo_table[number].bytes; return SUCCESS;
    case GRANULARITY_ELEMENTS: *value = fifo->granularity; return SUCCESS;
    case BUFFER_SIZE_ELEMENTS: *value = fifo->depth; return SUCCESS;
    case MIRRORED_ELEMENTS: *value = 0; return SUCCESS;
    case DMA_BUFFER_TYPE: *value = 1; return SUCCESS; /* allocated by the driver */
    case FLOW_CONTROL: *value = 2; return SUCCESS;    /* enabled */
    case ELEMENTS_ACQUIRED: *value = acquired(fifo); return SUCCESS;
    default: return FEATURE_NOT_SUPPORTED;
    }
}

static Status set_property(uint32_t number, uint32_t property, uint64_t value)
{
    if (number >= FIFOS)
        return INVALID_PARAMETER;
    struct fifo *fifo = &card.fifos[number];
    if (fifo->started)
        return NOT_SUPPORTED_WHILE_STARTED;
    switch (property) {
    case GRANULARITY_ELEMENTS: fifo->granularity = value ? value : 1; return SUCCESS;
    case BUFFER_SIZE_ELEMENTS: return configure(number, value, NULL);
    default: return FEATURE_NOT_SUPPORTED;
    }
}

#define DEFINE_PROPERTY(Name, ctype) \
    EXPORT Status NiFpgaDll_GetFifoProperty##Name( \
        uint32_t session, uint32_t fifo, uint32_t property, ctype *value) \
    { \
        ENTER(session); \
        uint64_t found = 0; \
        Status status = get_property(fifo, property, &found); \
        *value = (ctype)found; \
        return leave(entered, status); \
    } \
    EXPORT Status NiFpgaDll_SetFifoProperty##Name( \
        uint32_t session, uint32_t fifo, uint32_t property, ctype value) \
    { \
        ENTER(session); \
        return leave(entered, set_property(fifo, property, (uint64_t)value)); \
    }
DEFINE_PROPERTY(I32, int32_t)
DEFINE_PROPERTY(U32, uint32_t)
DEFINE_PROPERTY(I64, int64_t)
DEFINE_PROPERTY(U64, uint64_t)
DEFINE_PROPERTY(Ptr, uintptr_t)

#define DEFINE_SCALAR(Name, ctype) \
    DEFINE_FIFO(Name, ctype) \
    DEFINE_UNSUPPORTED(WriteFifo##Name) \
    DEFINE_UNSUPPORTED(AcquireFifoWriteElements##Name)
FOR_EACH_SCALAR(DEFINE_SCALAR)

DEFINE_UNSUPPORTED(AcquireFifoWriteRegion)
DEFINE_UNSUPPORTED(ReadFifoComposite)
DEFINE_UNSUPPORTED(WriteFifoComposite)
DEFINE_UNSUPPORTED(AcquireFifoReadElementsComposite)
DEFINE_UNSUPPORTED(AcquireFifoWriteElementsComposite)
DEFINE_UNSUPPORTED(GetPeerToPeerFifoEndpoint)
