"""Path followers to compare with: pure pursuit, Stanley, LQR with preview, feed-forward; their delay compensated."""
