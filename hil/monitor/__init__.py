"""What people look at: terminal view, web dashboard, plots. Zenoh clients; they never touch the control process."""
