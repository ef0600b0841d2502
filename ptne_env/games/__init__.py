"""Noncooperative games: what each player minimises."""

from ptne_env.games.base import Game as Game
from ptne_env.games.base import NoBestResponseError as NoBestResponseError
from ptne_env.games.check import GameReport as GameReport
from ptne_env.games.check import check_game as check_game
from ptne_env.games.energy import EnergyGame as EnergyGame
from ptne_env.games.family import GameFamily as GameFamily
from ptne_env.games.family import RandomEnergy as RandomEnergy
from ptne_env.games.family import SingleGame as SingleGame
from ptne_env.games.non_quadratic import NonQuadraticGame as NonQuadraticGame
