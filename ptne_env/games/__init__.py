"""Noncooperative games: the costs that players minimise. One file a game, and ``family`` for those drawn at random."""

from ptne_env.games.affine import AffineGame as AffineGame
from ptne_env.games.base import Game as Game
from ptne_env.games.base import NoBestResponseError as NoBestResponseError
from ptne_env.games.charging import ElectricVehicleCharging as ElectricVehicleCharging
from ptne_env.games.coupled import CoupledConstraint as CoupledConstraint
from ptne_env.games.coupled import priced as priced
from ptne_env.games.energy import EnergyGame as EnergyGame
from ptne_env.games.family import GameFamily as GameFamily
from ptne_env.games.family import RandomEnergy as RandomEnergy
from ptne_env.games.family import SingleGame as SingleGame
from ptne_env.games.family import require_strong_monotonicity as require_strong_monotonicity
from ptne_env.games.markets import NetworkedCournot as NetworkedCournot
from ptne_env.games.markets import Oligopoly as Oligopoly
from ptne_env.games.non_quadratic import NonQuadraticGame as NonQuadraticGame
from ptne_env.games.random_affine import RandomAffine as RandomAffine
from ptne_env.games.random_affine import WeaklyMonotoneGame as WeaklyMonotoneGame
from ptne_env.games.rates import RateControl as RateControl
from ptne_env.games.robots import ConnectivityControl as ConnectivityControl
from ptne_env.games.saturating import RandomSaturating as RandomSaturating
from ptne_env.games.saturating import SaturatingGame as SaturatingGame
