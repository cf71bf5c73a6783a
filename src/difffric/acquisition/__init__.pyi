from .card import open_card as open_card
from .push import Command as Command
from .recorder import acquire as acquire
from .simulated_card import SimulatedCard as SimulatedCard
