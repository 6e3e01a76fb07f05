"""From scenarios to models: sets of labelled sights, grid search, the eight SVMs, ONNX files."""
