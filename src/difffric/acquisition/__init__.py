"""Recording pushes with the FPGA card, or with a simulated one in its place.

`acquire` (`recorder`) makes a list of `Command`s in a session with a card and writes what the card
samples to a .tdms file, push by push; it gives an `Acquired` for each. `open_card` (`card`) opens a
session with real hardware, by nifpga; `SimulatedCard` is a session whose pushes come from any
function of velocity and stroke.

In order of what calls what: `recorder` goes through the pushes, `stream` brings the words of one
push from the card's FIFOs into the file and counts what is lost, `hardware_check` holds the words
against what the card itself saw, `card` names the parts of a session that are used.
`card_registers` is made from `fpga/registers.toml`; to change what the card offers, change that.

To add another card, write a class with the methods of `CardSession`, `Register` and `Fifo` (the
protocols in `card`) and give it to `acquire`: nothing else looks inside a session.

Nothing here imports a rig, JAX or the simulation, so that a recorder can run on a small computer.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
