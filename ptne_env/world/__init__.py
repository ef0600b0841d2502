"""The physics: parts of a scenario, the world that builds them, and the transition.

- ``scenario``, ``catalogue``: the names of all parts, and named scenarios
- ``graphs``, ``switching``: graphs, and topologies, which say which graph acts when
- ``clock``, ``starts``: the time transformation with the steps to the deadline, and initial estimates
- ``channels``, ``disturbances``: what happens to messages on their way, and to strategies
- ``world``, ``dynamics``: all parts built and checked, and the step
- ``distances``, ``rewards``: how far estimates are from the equilibrium, and what players are paid
"""
