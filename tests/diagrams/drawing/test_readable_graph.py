"""The graph's readable form: wired ports alone, each with a name."""

from diagrams.drawing.graph import readable


def test_graph_shows_wired_ports_with_names(rollout):
    text = readable(rollout.diagram.GetGraphvizString(max_depth=2, options={"plant/split": "I/O"}))
    assert "rankdir=LR" in text
    assert "WorldModelInstance" not in text
    assert "applied_spatial_force" not in text
    for anonymous in (">u0<", ">y0<", ">u1<", ">u<", ">y<"):
        assert anonymous not in text
    for name in ("arm_desired_state", "predicted_features", "recalled_postures", "alpha_hold", "posture_scaling"):
        assert f">{name}<" in text
