"""Path followers to compare with: pure pursuit, Stanley, LQR with preview."""
