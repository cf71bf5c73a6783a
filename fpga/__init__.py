"""The card: the description of its interface, and an emulator of it below NI's driver interface."""
