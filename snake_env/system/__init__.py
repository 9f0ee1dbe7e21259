"""What every command and file needs of the operating system: signals, exit codes, whole files."""
