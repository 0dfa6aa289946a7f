"""The `parapod` command; a module a subcommand, with the work that it does."""
