"""Upper bounds: what no policy can exceed on an episode, with proofs (docs/bounds.md). CPP needs the extra ``planning``."""
