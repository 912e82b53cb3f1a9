"""The 3-D view of the page, by Meshcat."""

from pydrake.geometry import Meshcat, MeshcatParams

from models.errors import InputError


def open_scene(port: int | None) -> Meshcat:
    """Meshcat at that port, or at a free one, on this machine alone; raises InputError where it cannot be had."""
    try:
        meshcat = Meshcat(MeshcatParams(host="localhost", port=port, show_stats_plot=False))
    except RuntimeError as error:
        raise InputError(f"the 3-D view cannot be served at port {port}: choose another --meshcat-port") from error
    for distraction in ("/Grid", "/Axes"):
        meshcat.SetProperty(distraction, "visible", False)
    meshcat.SetCameraPose([1.25, -0.75, 0.75], [0.33, 0.05, 0.15])
    return meshcat
