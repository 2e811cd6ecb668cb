"""The process of a program: how it is run, its signals, its watchdog, its log."""
