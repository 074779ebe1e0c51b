"""The doors: one file a command, its options beside what it does; cli.py is the table of them."""
