"""What an agent is, and how one is loaded: from a name, a file, a module, weights, or an ONNX model."""
