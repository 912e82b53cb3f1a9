"""One run of the whole closed loop, and what came of it."""

import numpy as np

CAN = (0.555, -0.041)


class Run:
    """One run, with what the network was fed."""

    def __init__(self, rollout, policy, encoder, episode, **options):
        calls, self.told = encoder.calls, []
        policy.learn(episode)
        self.episode = episode
        self.outcome, self.record = rollout.run(
            episode, on_event=lambda t, what: self.told.append((t, what)), **options
        )
        self.inputs = np.array(policy.inputs)
        self.encoded = encoder.calls - calls

    def words(self):
        return [what for _, what in self.told]
