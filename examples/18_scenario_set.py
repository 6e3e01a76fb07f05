"""A set of simulated tables: a row a scenario, with its truth and a stand-in operator's label.

Needs the extra `train`. `boxgrasp simulate OUT` does the same from the command line.
"""

import tempfile
from collections import Counter

from boxgrasp.execution import Store, local_workers
from boxgrasp.simulate.scenario import Recipe, targets_of
from boxgrasp.teaching.rows import RowConfig
from boxgrasp.teaching.sets import SetConfig, make_set, read_set

config = SetConfig(RowConfig(Recipe(targets_of("known")), seed=1), count=8)
with tempfile.TemporaryDirectory() as folder, local_workers(processes=1) as workers:
    store = Store(folder)  # or an fsspec URL
    make_set(store, "", config, workers, title="")
    _, rows = read_set(store)

print(f"{rows.count} rows, {len(rows)} columns")
print("targets:", dict(Counter(rows["target"].tolist())))
print("labels:", rows["label"].tolist(), "by", set(rows["label_source"].tolist()))
for k in range(rows.count):
    chosen = rows["label"][k] - 1  # of the 15 candidates
    seen = rows["given_visible_clearance_m"][k, chosen]
    true = rows["given_true_clearance_m"][k, chosen]
    print(f"{rows['target'][k]:14} chosen is clear by {seen:.3f} m as seen, {true:.3f} m in truth")
