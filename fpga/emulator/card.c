#include "card.h"

#include <pthread.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define SECOND 1000000000LL
#define LONGEST_SLEEP (5 * 1000000LL) /* [ns], so that another thread's calls are soon seen */
#define BLOCK 512                     /* samples at a time */
#define DEFAULT_DEPTH 16384           /* NI's, unless a FIFO is configured */
#define MIN(a, b) ((a) < (b) ? (a) : (b))

const struct register_entry register_table[REGISTERS] = {REGISTER_TABLE};
const struct fifo_entry fifo_table[FIFOS] = {FIFO_TABLE};

struct card card;
static pthread_mutex_t mutex = PTHREAD_MUTEX_INITIALIZER;

void card_lock(void) { pthread_mutex_lock(&mutex); }
void card_unlock(void) { pthread_mutex_unlock(&mutex); }

/* Time */

int64_t card_now(void)
{
    struct timespec now;
    if (!card.real)
        return card.now;
    clock_gettime(CLOCK_MONOTONIC, &now);
    return now.tv_sec * SECOND + now.tv_nsec;
}

/* Samples taken in the first `time` [ns] of a push, and the time at which so many are taken. Whole
 * seconds go apart, so that nothing overflows. */
static uint64_t samples_by(int64_t time)
{
    return time / SECOND * card.rate + time % SECOND * card.rate / SECOND;
}
static int64_t time_of(uint64_t samples)
{
    uint64_t rest = samples % card.rate * SECOND;
    return samples / card.rate * SECOND + (rest + card.rate - 1) / card.rate;
}

void card_look(void)
{
    if (!card.real)
        card.now += card.look;
    card_advance();
}

bool card_wait(uint64_t samples, int64_t deadline)
{
    int64_t wake = deadline;
    if (card.push) {
        samples = MIN(samples, card.push->removed_at);
        if (samples <= MIN(card.push->total, card.push->silent_at))
            wake = MIN(wake, card.began + time_of(samples));
    }
    if (!card.real) {
        if (wake == NEVER)
            return false;
        if (wake > card.now)
            card.now = wake;
    } else {
        int64_t pause = MIN(wake - card_now(), LONGEST_SLEEP);
        if (pause > 0) {
            struct timespec sleep = {0, pause};
            card_unlock();
            nanosleep(&sleep, NULL);
            card_lock();
        }
    }
    return true;
}

/* A push */

/* What the card's own logic sees of `n` samples from number `first` on. */
static void watch(const int16_t *words, const int32_t *counts, size_t n, uint64_t first)
{
    int64_t *value = card.value;
    int16_t low = INT16_MAX, high = INT16_MIN;
    uint16_t at_an_end = 0;
    for (size_t i = 0; i < n; i++) {
        low = MIN(low, words[i]);
        high = high > words[i] ? high : words[i];
        at_an_end += (words[i] == INT16_MIN) | (words[i] == INT16_MAX);
    }
    if (high > value[REG_PEAK_WORD])
        value[REG_PEAK_WORD] = high;
    value[REG_SATURATED_SAMPLES] += at_an_end;

    int64_t lost = value[REG_CONTACT_THRESHOLD_WORD];
    int64_t made = lost + value[REG_CONTACT_HYSTERESIS_WORD];
    if (card.contact ? low >= lost : high < made)
        return;
    for (size_t i = 0; i < n; i++) {
        if (!card.contact && words[i] >= made) {
            card.contact = true;
            value[REG_RELEASED] = false;
        } else if (card.contact && words[i] < lost) {
            card.contact = false;
            value[REG_RELEASED] = true;
            value[REG_RELEASE_SAMPLE] = first + i;
            value[REG_RELEASE_COUNT] = counts[i];
        }
    }
}

static size_t room(const struct fifo *fifo)
{
    return fifo->started ? fifo->depth - (fifo->put - fifo->freed) : 0;
}

static void put(const int16_t *words, const int32_t *counts, size_t n, uint64_t first)
{
    struct fifo *fifo = &card.fifos[FIFO_FORCE];
    for (size_t done = 0, part; done < n; done += part, fifo->put += part) {
        size_t at = fifo->put % fifo->depth;
        part = MIN(n - done, fifo->depth - at);
        memcpy((int16_t *)fifo->ring + at, words + done, part * sizeof *words);
    }
    fifo = &card.fifos[FIFO_POSITION];
    for (size_t done = 0, part; done < n; done += part, fifo->put += part) {
        size_t at = fifo->put % fifo->depth;
        part = MIN(n - done, fifo->depth - at);
        uint64_t *out = (uint64_t *)fifo->ring + at;
        for (size_t i = 0; i < part; i++)
            out[i] = (first + done + i) << 32 | (uint32_t)counts[done + i];
    }
}

static void push_free(struct push *push)
{
    if (push) {
        free(push->words);
        free(push->counts);
        free(push);
    }
}

void card_advance(void)
{
    struct push *push = card.push;
    if (!push)
        return;
    int64_t *value = card.value;
    uint64_t due = samples_by(card_now() - card.began);
    due = MIN(due, MIN(push->total, push->silent_at));
    card.removed |= due >= push->removed_at;
    due = MIN(due, push->removed_at);
    while ((uint64_t)value[REG_SAMPLES] < due) {
        uint64_t taken = value[REG_SAMPLES];
        size_t at = taken % push->n;
        size_t n = MIN(MIN(due - taken, push->n - at), BLOCK);
        watch(push->words + at, push->counts + at, n, taken);
        size_t passed = 0;
        if (!value[REG_OVERFLOW])
            passed = MIN(n, MIN(room(&card.fifos[FIFO_FORCE]), room(&card.fifos[FIFO_POSITION])));
        put(push->words + at, push->counts + at, passed, taken);
        value[REG_OVERFLOW] |= passed < n;
        value[REG_STREAMED] += passed;
        value[REG_SAMPLES] += n;
    }
    value[REG_ENCODER_ERROR] |= due > push->encoder_error_at;
    if (due == push->total) {
        value[REG_DONE] = true;
        card.irqs |= IRQ_PUSH_ENDED;
        card.push = NULL;
        push_free(push);
    }
}

void card_begin_push(void)
{
    card_advance(); /* what the last one still owes */
    push_free(card.push);
    card.push = NULL;
    for (int i = 0; i < REGISTERS; i++)
        if (register_table[i].kind == INDICATOR && i != REG_SAMPLE_RATE_HZ)
            card.value[i] = register_table[i].at_reset;
    card.contact = false;
    if (card.running && card.queue) {
        card.push = card.queue;
        card.queue = card.queue->next;
        card.began = card_now();
    }
}

void fifo_stop(struct fifo *fifo)
{
    fifo->started = false;
    fifo->put = fifo->got = fifo->freed = 0;
    fifo->outstanding_regions = 0;
}

void card_reset(void)
{
    card.running = false;
    push_free(card.push);
    card.push = NULL;
    card.contact = false;
    card.irqs = 0;
    for (int i = 0; i < REGISTERS; i++)
        card.value[i] = register_table[i].at_reset;
    card.value[REG_SAMPLE_RATE_HZ] = card.rate;
    for (int i = 0; i < FIFOS; i++)
        fifo_stop(&card.fifos[i]);
}

/* For the test's side, which feeds the card. Sample numbers of faults: UINT64_MAX for none. */

/* A new card, with no session and nothing to play. */
EXPORT void difffric_emulator_restart(bool real, uint32_t rate, int64_t look, const char *signature)
{
    card_lock();
    for (struct push *next; card.queue; card.queue = next) {
        next = card.queue->next;
        push_free(card.queue);
    }
    card.real = real;
    card.now = 0;
    card.rate = rate;
    card.look = look;
    card.removed = false;
    memset(card.sessions, 0, sizeof card.sessions);
    memset(card.contexts, 0, sizeof card.contexts);
    memset(card.failures, 0, sizeof card.failures);
    strncpy(card.signature, signature ? signature : SIGNATURE, sizeof card.signature - 1);
    card_reset();
    for (int i = 0; i < FIFOS; i++) {
        free(card.fifos[i].ring);
        card.fifos[i].ring = NULL;
        card.fifos[i].depth = DEFAULT_DEPTH;
        card.fifos[i].granularity = 1;
    }
    card_unlock();
}

/* Add a push to those that are to be played, one at each start: `n` samples, `repeats` times over.
 * The card takes no more from `silent_at` on, and is gone at `removed_at`. */
EXPORT Status difffric_emulator_add_push(
    const int16_t *words, const int32_t *counts, size_t n, uint64_t repeats,
    uint64_t silent_at, uint64_t removed_at, uint64_t encoder_error_at)
{
    struct push *push = malloc(sizeof *push), **end = &card.queue;
    if (push)
        *push = (struct push){malloc(n * sizeof *words), malloc(n * sizeof *counts), n, n * repeats,
                              silent_at, removed_at, encoder_error_at, NULL};
    if (!push || !push->words || !push->counts) {
        push_free(push);
        return MEMORY_FULL;
    }
    memcpy(push->words, words, n * sizeof *words);
    memcpy(push->counts, counts, n * sizeof *counts);
    card_lock();
    while (*end)
        end = &(*end)->next;
    *end = push;
    card_unlock();
    return SUCCESS;
}

/* Let time pass that the host spends elsewhere. */
EXPORT void difffric_emulator_pass(int64_t nanoseconds)
{
    card_lock();
    card.now += nanoseconds;
    card_advance();
    card_unlock();
}

EXPORT int64_t difffric_emulator_now(void)
{
    card_lock();
    int64_t now = card_now();
    card_unlock();
    return now;
}

/* For a process that only loads the library. */
__attribute__((constructor)) static void first(void)
{
    difffric_emulator_restart(false, 200000, 1000000, NULL);
}
