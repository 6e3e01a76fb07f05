"""Train one of the eight SVMs on a small set, and select with it.

Needs the extra `train`. `boxgrasp train SET OUT` trains all eight. Forty labels are far too few to
choose well: this shows the way, not the result.
"""

import tempfile
from pathlib import Path

from boxgrasp import GraspSelector, Gripper
from boxgrasp.execution import Store, local_workers
from boxgrasp.ranking.model_set import SVMS
from boxgrasp.simulate import demo_capture
from boxgrasp.simulate.scenario import Recipe, targets_of
from boxgrasp.teaching.rows import RowConfig
from boxgrasp.teaching.sets import SetConfig, make_set, read_set
from boxgrasp.teaching.train import Provenance, train_svm

single_grid = next(svm for svm in SVMS if svm.name == "single-grid")
config = SetConfig(
    RowConfig(Recipe(targets_of("known")), seed=1, target_sources=("given",)), count=40
)
with tempfile.TemporaryDirectory() as folder:
    store = Store(folder)
    with local_workers(processes=1) as workers:
        make_set(store, "", config, workers, title="")
    _, rows = read_set(store)

    made_with = Provenance("simulated", (1,), label_source="stand-in", gripper=Gripper())
    trained = train_svm(rows, single_grid, made_with)
    (Path(folder) / "single-grid.onnx").write_bytes(trained.onnx)
    record = trained.record
    print(f"C {record.C:.3g}, gamma {record.gamma:.3g}, {record.support_vectors} support vectors")
    print(f"cross-validated accuracy {record.accuracy:.2f} over classes {record.classes}")

    selector = GraspSelector({"ranker": "single-grid", "models": folder})
selection = selector.select(demo_capture())
print(selection.headline())
