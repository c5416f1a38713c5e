"""What an agent is, and how to load one from a name, a file, a module, weights, or an ONNX model."""
