/* Made from fpga/registers.toml by fpga/generate.py. */
#pragma once

#define SIGNATURE "0EE2699266E39E30138EE0BFD74434EC"
#define IRQ_PUSH_ENDED (1u << 0)

enum {
    REG_VELOCITY_NM_PER_S,
    REG_STROKE_NM,
    REG_QUIET_SAMPLES,
    REG_REST_SAMPLES,
    REG_CONTACT_THRESHOLD_WORD,
    REG_CONTACT_HYSTERESIS_WORD,
    REG_START,
    REG_SAMPLE_RATE_HZ,
    REG_DONE,
    REG_SAMPLES,
    REG_STREAMED,
    REG_OVERFLOW,
    REG_PEAK_WORD,
    REG_RELEASED,
    REG_RELEASE_SAMPLE,
    REG_RELEASE_COUNT,
    REG_ENCODER_ERROR,
    REG_SATURATED_SAMPLES,
    REGISTERS,  /* how many */
};
/* name, type, kind, address, value after a reset */
#define REGISTER_TABLE \
    {"velocity_nm_per_s", TYPE_U32, CONTROL, 360448, 0}, \
    {"stroke_nm", TYPE_U32, CONTROL, 360452, 0}, \
    {"quiet_samples", TYPE_U32, CONTROL, 360456, 0}, \
    {"rest_samples", TYPE_U32, CONTROL, 360460, 0}, \
    {"contact_threshold_word", TYPE_I16, CONTROL, 360464, 74}, \
    {"contact_hysteresis_word", TYPE_I16, CONTROL, 360468, 110}, \
    {"start", TYPE_Bool, CONTROL, 360472, 0}, \
    {"sample_rate_Hz", TYPE_U32, INDICATOR, 360476, 0}, \
    {"done", TYPE_Bool, INDICATOR, 360480, 0}, \
    {"samples", TYPE_U32, INDICATOR, 360484, 0}, \
    {"streamed", TYPE_U32, INDICATOR, 360488, 0}, \
    {"overflow", TYPE_Bool, INDICATOR, 360492, 0}, \
    {"peak_word", TYPE_I16, INDICATOR, 360496, -32768}, \
    {"released", TYPE_Bool, INDICATOR, 360500, 0}, \
    {"release_sample", TYPE_U32, INDICATOR, 360504, 0}, \
    {"release_count", TYPE_I32, INDICATOR, 360508, 0}, \
    {"encoder_error", TYPE_Bool, INDICATOR, 360512, 0}, \
    {"saturated_samples", TYPE_U32, INDICATOR, 360516, 0},

enum {
    FIFO_FORCE,
    FIFO_POSITION,
    FIFOS,
};
/* name, type, bytes of an element */
#define FIFO_TABLE \
    {"force", TYPE_I16, 2}, \
    {"position", TYPE_U64, 8},
