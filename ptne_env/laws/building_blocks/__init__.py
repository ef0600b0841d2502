"""What several laws are built from; no file of this folder is a law.

- ``own_gradient``: a model of the own gradient, by recursive least squares, and best responses to it
- ``messages``: which neighbour has the fresher copy of a component, and what a noisy or rounded message means
- ``reactions``: whether best responses of all players settle, and how neighbours will respond
"""
