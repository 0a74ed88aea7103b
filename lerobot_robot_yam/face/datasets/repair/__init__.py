"""What yam-repair-dataset does: read what a killed recording left, and write it as a whole data set."""
