"""Meanders by shortest paths: the curvature pushes a channel, and it takes the shortest route over its near strands."""
