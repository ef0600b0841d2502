"""An oligopoly of four firms that set prices, on the 4-cycle.

The game is `ptne_env.games.Oligopoly`, after Frihauf, Krstić and Başar (2012).

| | |
| --- | --- |
| Import | `from ptne_env import oligopoly_v0` |
| Registered as | `ptne/oligopoly-v0` (`pettingzoo.make("parallel", ...)` and `"aec"`) |
| Agents | `player_0` … `player_3` |
| Parallel API | yes |
| Observations, actions, rewards, arguments | the same for all scenarios: see `ptne_env.envs.parallel` |

Version history: v0, the first release.
"""

from ptne_env.envs.modules import environment_module

env, raw_env, parallel_env = environment_module("oligopoly")
