"""Five electric vehicles that charge in four time slots, on the 5-cycle.

The game is `ptne_env.games.ElectricVehicleCharging`; players have four components, and a box confines them.

| | |
| --- | --- |
| Import | `from ptne_env import ev_charging_v0` |
| Registered as | `ptne/ev-charging-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_4` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("ev-charging")
