"""Training: a deep Q-network from the batched simulator. Needs PyTorch (the extra `train`)."""
