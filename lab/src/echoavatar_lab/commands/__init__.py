"""The lab's commands, each a module with `add_arguments(parser)` and `run(args) -> int`. May import every room."""
