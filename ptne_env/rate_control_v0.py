"""Five users of three congested links, on the 5-cycle.

The game is `ptne_env.games.RateControl`, which is not quadratic; a box confines the players.

| | |
| --- | --- |
| Import | `from ptne_env import rate_control_v0` |
| Registered as | `ptne/rate-control-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_4` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("rate-control")
