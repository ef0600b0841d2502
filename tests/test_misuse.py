"""What users get wrong, one line each: an error that says what is expected, and nothing that is ignored."""

# ruff: noqa: F401 - the statements need the imports
import gymnasium
import networkx as nx
import numpy as np
import pettingzoo
import pytest

import ptne_env
from ptne_env import learn, theory
from ptne_env.envs.gymnasium import JointEnv, JointVectorEnv
from ptne_env.evaluation import POLICIES, Track
from ptne_env.execution import Runner
from ptne_env.suites import Suite

PUBLIC = {name: getattr(ptne_env, name) for name in ptne_env.__all__}
env = ptne_env.parallel_env("energy")

MISUSES = {
    # Names of scenarios and of their parts.
    "parallel_env('enrgy')": "unknown scenario 'enrgy'; did you mean 'energy'",
    "parallel_env('ptne/energy-v0')": "is an id of registries; the scenario is 'energy'",
    "parallel_env('ptne-v1/lier')": "unknown track of suite ptne-v1 'lier'; did you mean 'liar'",
    "parallel_env('ptne/liar')": "is an id of registries",
    "parallel_env('rounding')": "unknown scenario 'rounding'; did you mean 'ptne-v1/rounding'",
    "parallel_env('robust/liar')": "unknown suite 'robust'; did you mean 'robustness'",
    "parallel_env('builtins:dict/liar')": "'builtins:dict/liar' is a dict, not a Scenario",
    "parallel_env(env)": r"such as env\.scenario of an environment; got a NashSeekingEnv",
    "get_scenario(None)": "a scenario is a name or a Scenario, .* got a NoneType",
    "get_scenario('energy', kappa=2)": "unknown scenario field 'kappa'; choose from name, ",
    "get_scenario('energy', seed=2)": "unknown scenario field 'seed'; a seed is an argument of reset, evaluate",
    "get_scenario('energy', name='\x1b[31m')": "of printable characters, got '.x1b.31m'",
    "parallel_env('energy', game='enrgy')": "unknown game 'enrgy'; did you mean 'energy'",
    "parallel_env('energy', game='start:paper')": "built a PaperStart where a Game or GameFamily is needed",
    "parallel_env('energy', game='ptne_env.games:CostGames')": "has no 'CostGames' .* did you mean 'CostGame'",
    "parallel_env('energy', game=5)": "game is an object of the library's class for it, .*, got a int",
    "parallel_env('energy', start='rnd')": "unknown start 'rnd'; did you mean 'random'",
    "parallel_env('energy', start=np.zeros((3, 3)))": "for 3 players and dimension 3.*choose start='random'",
    "parallel_env('energy', channel='noisy')": "unknown channel 'noisy'; did you mean 'noise'",
    "parallel_env('energy', channel='noise')": r"missing .* 'std'; name it with .* FactorySpec.of\('channel:noise', ",
    "parallel_env('energy', channel='noise(sd=0.1)')": "part 'channel:noise' has no argument 'sd'; did you mean 'std'",
    "parallel_env('energy', channel='noise(0.1)')": r"are written as in 'static\(kappa=4\)', got 'noise\(0.1\)'",
    "parallel_env('energy', deadline=np.nan)": r"deadline must be a finite number above 0 \(T, in seconds\), got nan",
    "parallel_env('energy', topology=[(0.1, nx.cycle_graph(5))])": "graphs that take turns are pairs with dwell times",
    "FactorySpec.of('channel:nois').build()": "unknown channel 'nois'; did you mean 'noise'",
    "FactorySpec.of(3)": "a part is named by a string, a class or a function, got 3",
    "FactorySpec.of('channel:noise', std=env)": "arguments of a part are numbers, strings, lists and parts, got Nash",
    "parallel_env('energy-switching', topology=FactorySpec.of('topology:paper', dwell=0.003))": "use more steps",
    "parallel_env('energy-switching-transformed', steps=20)": "dwell, 0.25 on the transformed clock, is shorter than",
    "parallel_env('energy', disturbance=FactorySpec.of('disturbance:uniform', bound=np.inf))": "bound must be a finite",
    "parallel_env('energy', disturbance=FactorySpec.of('disturbance:uniform', bound=1, dwell=0))": "dwell must be",
    "Scenario.from_dict({'name': 'x', 'colour': 1})": r"unknown keys \['colour'\]",
    "Scenario.from_dict({'name': 'x'})": r"missing keys \['game', 'topology'\]",
    # Graphs and numbers of players.
    "parallel_env('energy', topology=np.zeros((5, 5)))": "graph is not connected.*1 says reaches player 0; add links",
    "parallel_env('energy', topology=nx.path_graph(4))": "the game has 5 players, the graphs 4; pass a topology= of 5",
    "parallel_env('energy', T=2)": "unexpected keyword argument 'T'; did you mean 'deadline'",
    "parallel_env('energy', topology=nx.path_graph(5, nx.DiGraph))": "not strongly connected.*player 1 says reaches pl",
    "parallel_env('energy', topology=[['a']])": "an adjacency matrix is an .N, N. table of numbers: could not",
    "parallel_env('energy', slots=1)": "a player has 2 neighbours and slots is 1; raise it to 2",
    "parallel_env('energy', players=7)": r"game of fixed size: .* game=FactorySpec.of\('game:random-energy', players=7",
    "parallel_env('energy-switching', players=7)": "a game and a topology of fixed size: .*topology:cycle', players=7",
    "parallel_env('random-energy', players=7.0)": "players must be a whole number of at least 2, got 7.0",
    "parallel_env('random-energy', num_players=7)": "unexpected keyword argument 'num_players'; did you mean 'players'",
    # Other arguments of environments.
    "parallel_env('energy', seed=3)": r"a seed is an argument of reset, .* such as reset\(seed=3\)",
    "gymnasium.make('ptne/energy-v0', seed=3)": r"^the environment got .*argument 'seed'; a seed is an argument",
    "pettingzoo.make('aec', 'ptne/energy-v0', stps=3)": "did you mean 'steps'",
    "parallel_env('energy', interface=3)": "unknown interface 3; choose from scaled, physical",
    "parallel_env('energy', reward={'digits': -1})": "weight of reward 'digits' must be a finite number of at least 0",
    "parallel_env('energy', reward={})": "unknown reward {}; choose from",
    "parallel_env('energy', reward={'digits': 1, 'score': 2})": "unknown reward 'score'; choose from digits, tracking",
    "parallel_env('energy', reward={'digits': np.nan})": "weight of reward 'digits' must be a finite number",
    "parallel_env('energy', reward=len)": "reward is one of digits, .*a function of .before, after, world., got",
    "parallel_env('energy', reward=['digits'])": "reward is one of digits, .*a function of .before, after, world., got",
    "parallel_env('non-quadratic', reward='regret')": "needs a best response.*choose digits, tracking or payoff",
    "parallel_env('energy', gain=-1.0)": r"gain \(c\) must be a finite number of at least 0",
    "parallel_env('energy', steps=0)": r"steps \(K\) must be a whole number of at least 1",
    "parallel_env('energy', s_end=0.0)": "s_end must be a finite number above 0",
    "parallel_env('energy', s_end=50.0)": "too long: float64 cannot tell T",
    "parallel_env('energy', s_end=30.0, steps=30000)": "steps = 30000 .* too short .*; use fewer steps or",
    "parallel_env('energy', hold_steps=3, gain=0.0)": "hold_steps need a gain c > 0",
    "parallel_env('energy', spacing='logarithmic')": "unknown spacing 'logarithmic'; choose from effective, transf",
    "parallel_env('energy', render_mode='ansi')": "unknown render_mode 'ansi'; choose None or one of human, rgb_array",
    "parallel_env('energy', deadline='1.2')": r"deadline must be .* above 0 \(T, in seconds\), got '1.2'",
    "parallel_env('energy', message_range=0.0)": "message_range must be .* above 0",
    "parallel_env('energy', message_range=np.inf)": "message_range must be a finite number",
    "parallel_env('energy', hold_steps=True)": "hold_steps must be a whole number of at least 0, got True",
    "parallel_env('energy', max_cycles='ten')": "max_cycles must be a whole number of at least 1, got 'ten'",
    "VectorParallelEnv('energy', 2.0)": "num_envs must be a whole number of at least 1, got 2.0",
    "JointVectorEnv('energy', 2, autoreset_mode='next')": "'next' is not a valid AutoresetMode",
    # Resets and steps.
    "env.reset(seed='1')": "a seed must be a whole number of at least 0, got '1'",
    "env.reset(options=[1])": r"reset options are a dictionary, such as .*, got \[1\]",
    "env.reset(options={'estimate': 0})": "unknown reset option 'estimate'; choose from estimates",
    "env.reset(options={1: 0})": "unknown reset option 1; choose from estimates",
    "JointEnv().reset(options={'reset_mask': 0})": "unknown reset option 'reset_mask'; choose from estimates",
    "JointVectorEnv().reset(options={'mask': 0})": "unknown reset option 'mask'; choose from estimates, reset_mask",
    "parallel_env('energy').step({})": r"no episode is running: call reset\(\) before step\(\)",
    "parallel_env('energy').estimates": r"has no state yet: call reset\(\) first",
    "parallel_env('energy').render()": "create the environment with render_mode='rgb_array' or 'human'",
    # Laws, policies and comparisons.
    "laws.Static(env)": r"Static is built from a layout, such as env\.layout, got a NashSeekingEnv",
    "laws.Static(env.layout, kappa='2')": "kappa must be a finite number of at least 0, got '2'",
    "laws.Static(env.layout).predict(np.zeros(3))": "built for observations of length 24 .*, got the shape",
    "PolicySpec(laws.Static, 'mine')": "the name of a policy must be a text",
    "PolicySpec('mine', len, 3)": "unknown interface 3; choose from scaled, physical, full",
    "PolicySpec('mine', [laws.Static])": "give a FactorySpec, a class or function that is called with the layout",
    "evaluate('statics', 'energy')": "unknown policy 'statics'; did you mean 'static'",
    "evaluate('static', 'energie')": "unknown scenario 'energie'; did you mean 'energy'",
    "evaluate('static', env)": r"got a NashSeekingEnv; the scenario of an environment is env\.scenario",
    "evaluate(dict, 'energy')": r"got the class dict; .* an object with predict, or PolicySpec\(name, function",
    "evaluate(len, 'energy')": r"got a builtin_function_or_method; .* PolicySpec\(name, function of the layout\)",
    "evaluate([5], 'energy')": r"a policy is a string, an object with predict, .*, got 5: wrap .*PolicySpec\(name, f",
    "evaluate({'mine': 5}, 'energy')": "policy 'mine' is 5: give a FactorySpec",
    "evaluate(['static', 'static'], 'energy')": "different names, got static, static; .* by a dictionary, {'mine': obj",
    "evaluate('static', ['energy', 'energy'])": "different names, and 'energy' is there twice",
    "evaluate('static(kapa=4)', 'energy')": "unknown argument of static 'kapa'; did you mean 'kappa'",
    "evaluate('static(x=4)', 'energy')": "unknown argument of static 'x'; choose from kappa, gradient_gain",
    "evaluate('static(4)', 'energy')": r"are written as in 'static\(kappa=4\)', got 'static\(4\)'",
    "evaluate('static(kappa=', 'energy')": r"unknown policy 'static\(kappa='; did you mean 'static'",
    "evaluate('static(kappa=k)', 'energy')": "arguments are written as in",
    "evaluate('static(kappa=4)()', 'energy')": "arguments are written as in",
    "evaluate('ppo(x=1)', 'energy')": "policy 'ppo' is a file and takes no arguments",
    "evaluate([], 'energy')": "at least one policy",
    "evaluate('static', [])": "needs at least one scenario",
    "evaluate('no.such.module:thing', 'energy')": "cannot import",
    "evaluate('ptne_env.laws:NoSuchLaw', 'energy')": "has no 'NoSuchLaw'",
    "evaluate('static', 'builtins:dict')": "is a dict, not a Scenario",
    "evaluate('static', 'ptne_env.suites.ptne_v1:SUITE')": "is a Suite, not a Scenario: name a track, as '",
    "Suite('mine', (get_scenario('energy'),))": "a suite consists of tracks, .*, got a Scenario",
    "learn.load('recurrent-random-worlds', env)": "loaded for a layout, such as env.layout, got a NashSeekingEnv",
    "Runner('results', 4)": r"the workers of a runner are Workers\(4\), for example; got 4",
    "evaluate('mine.npz', 'energy')": "there is no file 'mine.npz'",
    "evaluate('static', 'energy', episodes=True)": "episodes must be a whole number of at least 1, got True",
    "evaluate('static', 'energy', seed=2**32)": r"a seed is below 2\^32",
    "evaluate('static', 'energy', seed=-1)": "seed must be a whole number of at least 0, got -1",
    "evaluate('static', 'energy', split='validate')": "unknown split 'validate'; choose from train, validation, test",
    "evaluate('static', 'energy', run=4)": r"run takes jobs, as ptne_env.execution.Runner\(folder, Workers\(4\)\) does",
    "Track('mine', 'energy', 'A change.', scored='no')": "scored of track 'mine' must be True or False, got 'no'",
    r"Track('\x1b[2K', 'energy', 'A change.')": "the name of a track must be a text of printable",
    "POLICIES['static'].build('energy')": r"Static is built from a layout, such as env\.layout, got a str",
    "theory.certify('enrgy')": "unknown scenario 'enrgy'; did you mean 'energy'",
    "theory.certify(env.world)": r"a scenario is a name or a Scenario, .* got a World",
}


@pytest.mark.parametrize("statement", MISUSES)
def test_a_misuse_is_an_error_that_says_what_is_expected(statement):
    with pytest.raises((ValueError, TypeError, RuntimeError, FileNotFoundError), match=MISUSES[statement]):
        eval(statement, globals() | PUBLIC)  # noqa: S307 - of the table
