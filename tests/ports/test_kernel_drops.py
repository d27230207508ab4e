import socket

from drd.ports.can_port import dropped_by_kernel


def test_what_the_kernel_dropped_for_want_of_buffer_is_told_exactly() -> None:
    # The counter belongs to every socket; a datagram's stands in for a CAN frame's where there is no AF_CAN.
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        receiver.bind(("127.0.0.1", 0))
        receiver.setblocking(False)
        assert dropped_by_kernel(receiver) == 0
        for _ in range(200):
            sender.sendto(b"x" * 16, receiver.getsockname())
        kept = 0
        while True:
            try:
                receiver.recv(64)
            except BlockingIOError:
                break
            kept += 1
        assert 0 < kept < 200
        assert dropped_by_kernel(receiver) == 200 - kept
