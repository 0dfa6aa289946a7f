"""What can follow `parapod` on the command line: one module a command."""
