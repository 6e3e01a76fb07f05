"""Trained models: ONNX files with their records, asked through onnxruntime."""
