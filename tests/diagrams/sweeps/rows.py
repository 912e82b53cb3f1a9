"""Rows of a sweep made by hand, for tests of what reads tables."""

import numpy as np
import pandas as pd


def frame(rnn, flags, detector="recall", gamma=None, training_seed=0, disturbance="A"):
    """Rows of one controller: `flags` say which episodes succeeded, at the task and at the switching."""
    n = len(flags)
    flags = np.asarray(flags, bool)
    return pd.DataFrame(
        {
            "rnn": rnn, "detector": detector, "gamma": np.full(n, np.nan if gamma is None else gamma),
            "disturbance": disturbance, "training_seed": training_seed, "seed": np.arange(n), "success": flags,
            "switch_success": flags, "paper_switch_success": flags,
            "failure": [None if f else "stalled" for f in flags],
            "switch_failure": [None if f else "not resumed" for f in flags], "error": None,
            "void": False, "way_home_clear": None, "guard_crossings": 2, "later_switches": 0, "needless_s": 0.0,
            "false_switches": 0, "detection_delay_s": 0.2, "way_home_m": np.full(n, np.nan),
            "return_s": np.linspace(1.0, 3.0, n), "resume_s": np.full(n, np.nan),
            "sim_seconds": 40.0, "realtime_factor": 5.0,
        }
    )  # fmt: skip
