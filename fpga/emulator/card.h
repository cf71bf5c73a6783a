/* The emulated card: registers, FIFOs, and the pushes that it plays as time goes on.
 *
 * There is one card in a process, as there is one library. Every function here but those with a
 * `difffric_emulator_` name is called with the card locked.
 */
#pragma once

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "registers.h"

#define EXPORT __attribute__((visibility("default")))
#define NEVER INT64_MAX /* a time [ns] that does not come */
#define REGIONS 16      /* that a FIFO may have acquired at a time */
#define SESSIONS 8
#define CONTEXTS 8
#define FAILURES 16

typedef int32_t Status;
enum {
    SUCCESS = 0,
    FIFO_TIMEOUT = -50400,
    MEMORY_FULL = -52000,
    INVALID_PARAMETER = -52005,
    RESOURCE_NOT_FOUND = -52006,
    FPGA_ALREADY_RUNNING = 61003, /* a warning */
    BAD_DEPTH = -61072,
    BAD_READ_WRITE_COUNT = -61073,
    REGIONS_OUTSTANDING = -61217,
    NOT_PERMISSIBLE_TO_BE_ACQUIRED = -61219,
    ELEMENTS_CURRENTLY_ACQUIRED = -63083,
    NOT_SUPPORTED_WHILE_STARTED = -63086,
    OUT_OF_FIFO_REGIONS = -63088,
    BITFILE_READ_ERROR = -63101,
    SIGNATURE_MISMATCH = -63106,
    HARDWARE_FAULT = -63150,
    FEATURE_NOT_SUPPORTED = -63193,
    INVALID_SESSION = -63195,
    OUT_OF_HANDLES = -63198,
};

/* As nifpga names them, which is how the entry points end. */
enum type {
    TYPE_Bool, TYPE_I8, TYPE_U8, TYPE_I16, TYPE_U16, TYPE_I32, TYPE_U32, TYPE_I64, TYPE_U64,
    TYPE_Sgl, TYPE_Dbl,
};
enum kind { CONTROL, INDICATOR };

struct register_entry {
    const char *name;
    enum type type;
    enum kind kind;
    uint32_t address;
    int64_t at_reset;
};
struct fifo_entry {
    const char *name;
    enum type type;
    uint32_t bytes; /* of an element */
};
extern const struct register_entry register_table[REGISTERS];
extern const struct fifo_entry fifo_table[FIFOS];

struct region {
    size_t elements;
    bool released;
};

/* The host's ring. Counts are of elements since the start: put by the card, got by the host (read
 * or acquired), freed by the host. freed <= got <= put <= freed + depth. */
struct fifo {
    uint8_t *ring;
    size_t depth, granularity;
    uint64_t put, got, freed;
    bool started;
    struct region regions[REGIONS]; /* acquired, the oldest at `oldest_region` */
    unsigned oldest_region, outstanding_regions;
};

/* Words to play: `n` of them, `total` samples in all. The faults are sample numbers. */
struct push {
    int16_t *words;
    int32_t *counts;
    size_t n;
    uint64_t total;
    uint64_t silent_at, removed_at, encoder_error_at;
    struct push *next;
};

/* Calls that are to fail. */
struct failure {
    char name[48]; /* without NiFpgaDll_ */
    Status status;
    uint64_t skip, times;
};

struct card {
    bool real;    /* the clock: CLOCK_MONOTONIC, or one that only the host's calls move */
    int64_t now;  /* [ns] of the latter */
    int64_t look; /* [ns] that a call takes which waits for nothing */
    uint32_t rate;
    char signature[64];
    bool running, removed;
    int64_t value[REGISTERS];
    uint32_t irqs; /* asserted and not acknowledged */
    struct fifo fifos[FIFOS];
    struct push *queue;
    struct push *push; /* under way */
    int64_t began;
    bool contact;
    uint32_t sessions[SESSIONS]; /* 0: a free place */
    bool contexts[CONTEXTS];
    struct failure failures[FAILURES];
};
extern struct card card;

void card_lock(void);
void card_unlock(void);

int64_t card_now(void);
/* Take all samples that are due. */
void card_advance(void);
/* Let the time of a look pass, and take what is due. */
void card_look(void);
/* Let time go on until `samples` of the push are taken, or until `deadline`; the caller asks again
 * whether what it waits for has come. False where nothing can ever come. */
bool card_wait(uint64_t samples, int64_t deadline);

/* Begin the next push of the queue; without one, or where the card does not run, none begins. */
void card_begin_push(void);
/* Stop, and put registers and FIFOs back. */
void card_reset(void);
/* Stop a FIFO and forget what it holds. */
void fifo_stop(struct fifo *fifo);
