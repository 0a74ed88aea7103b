"""Repair of a data set: read what a killed recording left, and write it as a whole data set."""
