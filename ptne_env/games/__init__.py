"""Noncooperative games: the costs that players minimise. ``base`` has their interface."""

from ptne_env.games.affine import AffineGame as AffineGame
from ptne_env.games.affine import QuadraticGame as QuadraticGame
from ptne_env.games.affine import RandomAffine as RandomAffine
from ptne_env.games.base import Game as Game
from ptne_env.games.base import GameFamily as GameFamily
from ptne_env.games.base import NoBestResponseError as NoBestResponseError
from ptne_env.games.base import require_strong_monotonicity as require_strong_monotonicity
from ptne_env.games.costs import CostGame as CostGame
from ptne_env.games.coupled import CoupledConstraint as CoupledConstraint
from ptne_env.games.coupled import PricedGame as PricedGame
from ptne_env.games.coupled import price_constraint as price_constraint
from ptne_env.games.energy import EnergyGame as EnergyGame
from ptne_env.games.energy import RandomEnergy as RandomEnergy
from ptne_env.games.literature import ConnectivityControl as ConnectivityControl
from ptne_env.games.literature import ElectricVehicleCharging as ElectricVehicleCharging
from ptne_env.games.literature import NetworkedCournot as NetworkedCournot
from ptne_env.games.literature import Oligopoly as Oligopoly
from ptne_env.games.literature import RateControl as RateControl
from ptne_env.games.literature import WeaklyMonotoneGame as WeaklyMonotoneGame
from ptne_env.games.market import CournotMarket as CournotMarket
from ptne_env.games.market import Market118 as Market118
from ptne_env.games.non_quadratic import NonQuadraticGame as NonQuadraticGame
from ptne_env.games.saturating import RandomSaturating as RandomSaturating
from ptne_env.games.saturating import SaturatingGame as SaturatingGame
