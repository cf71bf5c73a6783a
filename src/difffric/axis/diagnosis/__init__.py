"""What an axis does beyond Coulomb and viscous friction.

`screening` asks of each effect, over a grid of what it has (a period, a speed), how much better it
would explain the motion; `procedure` fits the best ones in full, adds what is beyond chance, and
judges on stretches held out (`held_out`); `verdict` is what it says.
"""
