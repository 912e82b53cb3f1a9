"""The one list of the detectors; any of PyOD's is `pyod:NAME`, such as pyod:IForest."""

from models.registry import Registry

DETECTORS: Registry = Registry(
    "detector",
    {
        "recall": "systems.recall_detector:RecallDetector",
        "knn": "systems.knn_detector:KnnDetector",
        "subspace": "systems.subspace_detector:SubspaceDetector",
        "innovation": "systems.innovation_detector:InnovationDetector",
        "innovation_posture": "systems.innovation_detector:PostureInnovation",
        "innovation_features": "systems.innovation_detector:FeatureInnovation",
        "recall_innovation": "systems.recall_detector:RecallInnovation",
        "innovation_cusum": "systems.cusum_detector:CusumDetector",
        "mahalanobis": "systems.mahalanobis_detector:MahalanobisDetector",
        "pca_kmeans": "systems.clusters_detector:ClustersDetector",
        "rnd": "systems.distillation_detector:DistillationDetector",
        "logpzo": "systems.flow_detector:FlowDetector",
        "ensemble": "systems.ensemble_detector:EnsembleDetector",
        "reversals": "systems.reversals_detector:ReversalsDetector",
        "speed": "systems.speed_detector:SpeedDetector",
        "never": "systems.never_detector:NeverDetector",
        "oracle": "systems.oracle_detector:OracleDetector",
    },
    needs=("build",),
    families={"pyod": "systems.pyod_detector:pyod_detector"},
)
