"""The one list of the detectors."""

from models.registry import Registry

DETECTORS: Registry = Registry(
    "detector",
    {
        "recall": "systems.recall_detector:RecallDetector",
        "knn": "systems.knn_detector:KnnDetector",
        "subspace": "systems.subspace_detector:SubspaceDetector",
        "never": "systems.never_detector:NeverDetector",
    },
    needs=("build",),
)
