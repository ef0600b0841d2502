"""Policies that cheat, or misbehave in other ways. The tests show that each is caught, or that it gains nothing.

Each is built from a layout, by ``cheats.<module>:<class>``. A cheat that finds nothing to cheat with plays the law
``grounded``, so its digits then equal those of the law.
"""
