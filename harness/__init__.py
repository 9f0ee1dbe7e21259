"""What every command shares: options, console, exit codes, files, and parallel work."""
