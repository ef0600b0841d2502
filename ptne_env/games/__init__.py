"""Noncooperative games: the costs that players minimise."""

from ptne_env.games.affine import AffineGame as AffineGame
from ptne_env.games.base import Game as Game
from ptne_env.games.base import NoBestResponseError as NoBestResponseError
from ptne_env.games.energy import EnergyGame as EnergyGame
from ptne_env.games.family import GameFamily as GameFamily
from ptne_env.games.family import RandomEnergy as RandomEnergy
from ptne_env.games.family import SingleGame as SingleGame
from ptne_env.games.family import require_strong_monotonicity as require_strong_monotonicity
from ptne_env.games.non_quadratic import NonQuadraticGame as NonQuadraticGame
