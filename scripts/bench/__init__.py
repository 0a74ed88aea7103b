"""Parts of scripts/bench.py and scripts/bench_ik.py."""
