"""The daemon: inputs, the loop, reload, real time, systemd."""
