"""A game that is monotone but not strongly monotone, on the 5-cycle.

The game is `ptne_env.games.WeaklyMonotoneGame`, for which Assumption 4 of the paper fails.

| | |
| --- | --- |
| Import | `from ptne_env import weakly_monotone_v0` |
| Registered as | `ptne/weakly-monotone-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_4` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("weakly-monotone")
