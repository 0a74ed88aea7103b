"""The yam-* console commands; `lib` has what several share."""
