"""Upper bounds: what no policy can exceed on an episode, with proofs (docs/bounds.md). Needs the extra ``planning``."""
