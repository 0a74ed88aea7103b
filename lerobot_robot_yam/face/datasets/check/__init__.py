"""Check of a data set that loads: what in it would harm a training or a replay."""
