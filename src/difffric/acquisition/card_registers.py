"""Made from fpga/registers.toml by fpga/generate.py: the card's interface."""

SIGNATURE = "0EE2699266E39E30138EE0BFD74434EC"
CONTROLS = {
    "velocity_nm_per_s": "U32: commanded speed of the pusher",
    "stroke_nm": "U32: its travel",
    "quiet_samples": "U32: samples before the pusher starts, which it does half a sample later",
    "rest_samples": "U32: samples after part and pusher have come to rest",
    "contact_threshold_word": "I16: contact is lost where the force falls below this",
    "contact_hysteresis_word": "I16: contact is made where it reaches the threshold and this more",
    "start": "Boolean: true starts a push, and clears the indicators of the last",
}
INDICATORS = {
    "sample_rate_Hz": "U32: of both FIFOs",
    "done": "Boolean: the push has ended, and no more of its words will come",
    "samples": "U32: samples taken in this push",
    "streamed": "U32: those of them whose words went into both FIFOs",
    "overflow": "Boolean: a FIFO was full, and both have been closed until the push ends",
    "peak_word": "I16: the largest force word of this push",
    "released": "Boolean: contact was made in this push, lost, and not made again",
    "release_sample": "U32: the first sample after contact was last lost",
    "release_count": "I32: the encoder's count at that sample",
    "encoder_error": "Boolean: both signals of the encoder changed at once: counts are off",
    "saturated_samples": "U32: samples of this push at either end of the converter",
}
FIFOS = {
    "force": "I16: the converter's word, a sample a word",
    "position": "U64: sample number in this push (upper 32 bits), encoder count (lower, signed)",
}
AT_RESET = {
    "velocity_nm_per_s": 0,
    "stroke_nm": 0,
    "quiet_samples": 0,
    "rest_samples": 0,
    "contact_threshold_word": 74,
    "contact_hysteresis_word": 110,
    "start": False,
    "sample_rate_Hz": 0,
    "done": False,
    "samples": 0,
    "streamed": 0,
    "overflow": False,
    "peak_word": -32768,
    "released": False,
    "release_sample": 0,
    "release_count": 0,
    "encoder_error": False,
    "saturated_samples": 0,
}
"""what each register holds after a reset"""
IRQ_PUSH_ENDED = 0  # number of the interrupt
ADC_VOLTS = 10.0  # [V], the converter's range, either sign
METRES_PER_COUNT = 2e-08  # [m], the encoder's step
