"""What every command shares: options, console, folders, files, and parallel work."""
