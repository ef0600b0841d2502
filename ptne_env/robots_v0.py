"""Five robots in the plane that keep in touch, on the 5-cycle.

The game is `ptne_env.games.ConnectivityControl`; players have two components.

| | |
| --- | --- |
| Import | `from ptne_env import robots_v0` |
| Registered as | `ptne/robots-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_4` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("robots")
