"""Cournot competition of five firms on three markets, with capacities, on the 5-cycle.

The game is `ptne_env.games.NetworkedCournot`; players have one or two components, and a box confines them.

| | |
| --- | --- |
| Import | `from ptne_env import cournot_v0` |
| Registered as | `ptne/cournot-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_4` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("cournot")
