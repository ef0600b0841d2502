"""The batched rollout against the environment, step by step."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

import ptne_env
from ptne_env import PolicySpec, evaluate, laws
from ptne_env.evaluation.episodes import EpisodeSet, episode_seed
from ptne_env.evaluation.metrics import OPTIONAL, measure, settling_time
from ptne_env.evaluation.rollout import Rollout, rollout
from ptne_env.perception.encoder import Encoder
from ptne_env.perception.observation import Interface
from ptne_env.perception.policy import PolicyError
from ptne_env.world import dynamics
from ptne_env.world.world import World


def run(scenario, policy, interface=None, episodes=4, seed=3):
    world = World(scenario)
    encoder = Encoder(world, interface or Interface("physical"))
    return world, rollout(policy(encoder.layout), encoder, EpisodeSet(episodes, seed).initial_state(world))


@pytest.mark.parametrize("name", ["energy", "energy-switching", "non-quadratic-switching", "random-energy-switching"])
@pytest.mark.parametrize("law", [laws.Static, laws.Adaptive])
def test_metrics_of_a_batch_are_those_of_single_episodes_in_the_environment(name, law):
    scenario = ptne_env.get_scenario(name, start="random", hold_steps=7, steps=300)
    world, batch = run(scenario, law, episodes=3)
    samples = measure(batch)
    clock = world.clock
    for episode in range(3):
        env = ptne_env.parallel_env(scenario, interface="physical")
        observations, _ = env.reset(seed=episode_seed(3, episode))
        policy, memory = law(env.layout), None
        gained, input_energy, peak = 0.0, 0.0, 0.0
        for step in range(clock.total_steps):
            agents = env.agents
            actions, memory = policy.predict(np.stack([observations[agent] for agent in agents]), memory)
            observations, rewards, *_ = env.step(dict(zip(agents, actions, strict=True)))
            gained += np.mean(list(rewards.values()))
            if step < clock.steps:
                inputs = actions.astype(float)
                input_energy += clock.dt[step] * (inputs**2).sum()
                peak = max(peak, np.abs(inputs).max())
            if step + 1 == clock.steps:
                equilibrium = env.nash_equilibrium
                scale = np.linalg.norm(equilibrium)
                strategy = np.linalg.norm(env.strategies - equilibrium) / scale
                estimate = np.linalg.norm(env.estimates - equilibrium) / (np.sqrt(5) * scale)
        expected = {
            "strategy_distance": strategy,
            "estimate_distance": estimate,
            "digits": -np.log10(estimate),
            "digits_gained": gained,
            "input_energy": input_energy,
            "peak_input": peak,
        }
        for metric, value in expected.items():
            assert samples[metric][episode] == pytest.approx(value, rel=1e-9, abs=1e-12), metric


def test_digits_after_hold_exist_only_with_a_hold_phase():
    _, without = run(ptne_env.get_scenario("energy"), laws.Static, episodes=1)
    _, with_hold = run(ptne_env.get_scenario("energy", hold_steps=40), laws.Static, episodes=1)
    assert np.isnan(measure(without)["digits_after_hold"]).all()
    assert measure(with_hold)["digits_after_hold"][0] > measure(with_hold)["digits"][0] + 0.3
    assert measure(with_hold)["digits"] == measure(without)["digits"]


def test_digits_on_the_way_are_the_mean_after_every_step_to_the_deadline():
    world, batch = run(ptne_env.get_scenario("energy", start="random", hold_steps=9), laws.Static)
    after = -np.log10(batch["estimate_distance"][1 : world.clock.steps + 1])
    assert measure(batch)["digits_on_the_way"] == pytest.approx(after.mean(axis=0), rel=1e-9)
    _, still = run(ptne_env.get_scenario("energy", start="random"), laws.ZeroInput)
    assert measure(still)["digits_on_the_way"] == pytest.approx(measure(still)["digits"])
    _, oracle = run(ptne_env.get_scenario("energy", start="random"), laws.Oracle, Interface("full"))
    assert measure(oracle)["digits_on_the_way"].max() <= 12


def test_mean_regret_is_the_mean_over_time_relative_to_the_start():
    scenario = ptne_env.get_scenario("energy", start="random")
    found = {law.__name__: measure(run(scenario, law)[1]) for law in (laws.ZeroInput, laws.Static, laws.Grounded)}
    assert found["ZeroInput"]["mean_regret"] == pytest.approx(1.0)
    assert (found["Grounded"]["mean_regret"] < found["Static"]["mean_regret"]).all()
    world, batch = run(scenario, laws.Static)
    states = []
    encoder = Encoder(world, Interface("physical"))
    start = EpisodeSet(4, 3).initial_state(world)
    rollout(laws.Static(encoder.layout), encoder, start, watch=lambda state, _: states.append(state))
    chosen = np.arange(21) ** 2  # of 400 steps
    regrets = [world.game.regrets(dynamics.strategies(states[step])).sum(axis=0) for step in chosen]
    assert batch["regret"] == pytest.approx(np.array(regrets), rel=1e-9)
    mean = np.trapezoid(regrets, world.clock.t[chosen], axis=0) / 1.2
    assert measure(batch)["mean_regret"] == pytest.approx(mean / regrets[0], rel=1e-9)


def test_mean_regret_does_not_exist_without_best_responses():
    _, batch = run(ptne_env.get_scenario("non-quadratic", steps=7), laws.Static)
    assert batch["regret"].shape == (8, 4)  # every instant
    assert np.isnan(measure(batch)["mean_regret"]).all()


def test_a_diverged_episode_has_the_digits_of_the_range_limit_and_finite_metrics():
    scenario = ptne_env.get_scenario("non-quadratic", start="random")
    world, batch = run(scenario, laws.RandomPolicy)
    assert batch.diverged.all()
    samples = measure(batch)
    np.testing.assert_allclose(samples["digits"], -np.log10(dynamics.distance_limit(world.game)[0]))
    assert (samples["settled_share"] == 0).all()
    assert (samples["diverged_share"] == 1).all()
    missing = {"settling_time", "digits_after_hold", "regret", "mean_regret"}
    for metric, values in samples.items():
        if metric not in missing:  # the game has neither hold phase nor best response
            assert np.isfinite(values).all(), metric


def test_a_diverging_episode_leaves_the_others_of_its_batch_alone():
    class Reckless:
        """The static law, but the second episode's players push as hard as they can."""

        def __init__(self, layout):
            self.law = laws.Static(layout)

        def predict(self, observation, state=None, episode_start=None, deterministic=False):
            actions, state = self.law.predict(observation, state, episode_start, deterministic)
            actions[5:10] = 1000.0
            return actions, state

    scenario = ptne_env.get_scenario("non-quadratic", start="random")
    _, mixed = run(scenario, Reckless, episodes=3)
    _, calm = run(scenario, laws.Static, episodes=3)
    assert mixed.diverged.tolist() == [False, True, False]
    np.testing.assert_array_equal(mixed["estimate_distance"][:, [0, 2]], calm["estimate_distance"][:, [0, 2]])


class Answering:
    def __init__(self, answer):
        self.answer = answer

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        return self.answer(observation), state


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (lambda observation: np.zeros((len(observation), 4), dtype=np.float32), "shape"),
        (lambda observation: np.full((len(observation), 5), np.nan, dtype=np.float32), "not finite"),
        (lambda observation: np.zeros((len(observation), 5), dtype=np.complex64), "has the dtype complex64"),
        (lambda observation: np.zeros((len(observation), 5), dtype=bool), "has the dtype bool"),
        (lambda observation: np.ma.masked_array(np.zeros((len(observation), 5))), "is a masked array"),
        (lambda observation: [[0.0], *([0.0] * 5 for _ in observation[1:])], "is ragged"),
    ],
)
def test_actions_of_a_wrong_shape_or_value_are_refused(answer, message):
    with pytest.raises(PolicyError, match=f"step 0: .*{message}"):
        run(ptne_env.get_scenario("energy"), lambda layout: Answering(answer), episodes=1)


@pytest.mark.parametrize(
    "action", [np.zeros(5, complex), np.zeros(5, bool), np.ma.masked_array(np.zeros(5)), np.ones(4)]
)
def test_evaluation_and_an_environment_refuse_an_action_in_the_same_words(action):
    env = ptne_env.parallel_env("energy", interface="physical")
    env.reset(seed=0)
    with pytest.raises(ValueError, match="the action of player_0 ") as refused:
        env.step(dict.fromkeys(env.agents, action))
    words = str(refused.value).split("; the action of")[0].removeprefix("the action of player_0 ").partition(" (")[0]
    answer = np.ma.stack([action] * 5) if isinstance(action, np.ma.MaskedArray) else np.stack([action] * 5)
    with pytest.raises(PolicyError, match=re.escape(f"its answer to 5 observations {words}")):
        run(ptne_env.get_scenario("energy"), lambda layout: Answering(lambda _: answer), episodes=1)


@pytest.mark.parametrize("error", [SystemExit(0), SystemExit("bye"), MemoryError("too much")])
def test_a_policy_that_exits_or_needs_too_much_memory_fails_like_any_other(error):
    def raising(_):
        raise error

    results = evaluate({"mine": Answering(raising), "static": laws.Static}, "energy", episodes=1)
    assert results.failures["energy", "mine"].startswith(f"step 0: {type(error).__name__}")
    assert ("energy", "static") in results.samples
    assert (
        "cannot be built"
        in evaluate({"mine": raising, "static": laws.Static}, "energy", episodes=1).failures["energy", "mine"]
    )


def test_ctrl_c_within_a_policy_ends_the_run():
    def interrupted(_):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        evaluate(PolicySpec("mine", Answering(interrupted)), "energy", episodes=1)


@pytest.mark.parametrize("name", ["energy-switching", "random-energy-switching"])
def test_a_message_is_new_unless_the_link_carried_the_same_estimates_in_the_step_before(name):
    class Halting(laws.Static):
        """Moves in every third step."""

        def inputs(self, observation, memory):
            inputs, memory = super().inputs(observation, memory)
            return np.where(np.round(observation.elapsed * 30) % 3 == 0, inputs, 0.0), memory

    world, batch = run(ptne_env.get_scenario(name, steps=30, spacing="physical"), Halting, episodes=3)
    env = ptne_env.parallel_env(world.scenario, interface="physical")
    law = Halting(env.layout)
    for episode in range(3):
        observations, _ = env.reset(seed=episode_seed(3, episode))
        sent, new, carried = 0, 0, {}
        while env.agents:
            graph = world.topology.graphs[world.modes[env.get_state().step[0]]].adjacency
            links, estimates = zip(*np.nonzero(graph), strict=True), env.estimates
            before, carried = carried, {(i, j): tuple(estimates[j]) for i, j in links}
            sent += len(carried)
            new += sum(before.get(link) != message for link, message in carried.items())
            actions, _ = law.predict(np.stack(list(observations.values())))
            observations, *_ = env.step(dict(zip(env.agents, actions, strict=True)))
        assert 0 < new < sent
        assert [OPTIONAL[metric].value(batch)[episode] for metric in ("messages", "new_messages")] == [sent, new]


def test_settling_time_is_the_first_instant_after_which_the_distance_stays_inside():
    times = np.array([0.0, 1.0, 2.0, 3.0])
    distance = np.array(
        [
            # never outside, in and out again, ends outside, settles at the last instant
            [0.001, 1.0, 1.0, 1.0],
            [0.001, 0.001, 0.001, 1.0],
            [0.001, 1.0, 0.001, 1.0],
            [0.001, 0.001, 1.0, 0.001],
        ]
    )
    world = SimpleNamespace(clock=SimpleNamespace(t=times))
    found = settling_time(Rollout(world, {"strategy_distance": distance}, np.zeros(4, dtype=bool), 0.0))
    np.testing.assert_array_equal(found, [0.0, 3.0, np.nan, 3.0])


def test_saturated_components_are_counted_at_the_limit_alone():
    scenario = ptne_env.get_scenario("energy", start="random", input_limit=20.0)
    world, found = run(scenario, lambda layout: laws.Static(layout, kappa=4.0))
    total = found["saturated"].sum(axis=0)
    assert (total > 0).all()
    assert ((measure(found)["saturated_share"] > 0) & (measure(found)["saturated_share"] < 1)).all()
    assert (found["saturated"] <= world.game.num_players * world.game.dimension).all()
    assert (found["saturated"][found["peak_input"] < np.float32(19.9)] == 0).all()
    assert (found["saturated"][found["peak_input"] >= np.float32(20.0)] > 0).all()
