"""PPO reaches a known optimum, with one continuation a prompt."""

from tests.align.tuning import book, policy, training, wants_threes

from echoavatar.align.ppo import PpoTrainer


def test_a_policy_learns_to_say_the_wanted_code_everywhere_and_the_critic_foretells_it():
    """Returns come near 1 and 0.5 at the two tokens: a critic that still said 0 would be off by 0.31."""
    settings = training(
        "ppo", group=1, batch=16, discount=1.0, epochs=2, learning_rate=2e-2, critic_rate=5e-2
    )
    trainer = PpoTrainer(policy(), policy(), settings, wants_threes, book=book())
    told = [trainer.step() for _ in range(18)]
    assert told[0]["reward"] < 0.3
    assert told[-1]["reward"] > 0.9
    assert told[-1]["value"] < 0.1
