"""The `mdm` command."""
