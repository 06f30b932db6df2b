"""The subcommands of `drone-env`, one file each."""
