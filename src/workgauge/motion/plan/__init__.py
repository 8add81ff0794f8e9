"""A way round what stands between: a tree in joint space, shortened and made smooth."""
