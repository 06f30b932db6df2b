"""Records of flights."""
