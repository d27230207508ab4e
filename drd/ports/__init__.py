"""The serial port and the CAN bus."""
