"""The paper's experiments: every variant and baseline trained alike, rolled out on test sequences, and tabled."""
