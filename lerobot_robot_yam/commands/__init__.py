"""Console commands about one arm; none of them imports lerobot."""
