"""More games: of markets, networks and robots, in which laws and policies are compared."""

from ptne_env.field.games.affine import RandomAffine as RandomAffine
from ptne_env.field.games.affine import WeaklyMonotoneGame as WeaklyMonotoneGame
from ptne_env.field.games.charging import ElectricVehicleCharging as ElectricVehicleCharging
from ptne_env.field.games.coupled import CoupledConstraint as CoupledConstraint
from ptne_env.field.games.coupled import priced as priced
from ptne_env.field.games.markets import NetworkedCournot as NetworkedCournot
from ptne_env.field.games.markets import Oligopoly as Oligopoly
from ptne_env.field.games.rates import RateControl as RateControl
from ptne_env.field.games.robots import ConnectivityControl as ConnectivityControl
from ptne_env.field.games.saturating import RandomSaturating as RandomSaturating
from ptne_env.field.games.saturating import SaturatingGame as SaturatingGame
