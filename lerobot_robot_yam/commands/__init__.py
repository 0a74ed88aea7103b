"""The yam-* console commands; `data` has those that work on data sets, `lib` what several share."""
