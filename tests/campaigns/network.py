"""Hosts of a network of their own on this machine, by Linux's network namespaces; or this machine alone."""

import shutil
import subprocess

LASTS = "7200"  # s, at most


class Network:
    """Host 0 is the hub, with the driver and the scheduler; a context manager.

    Attributes:
        hosts: their number beside the hub.
        apart: whether the hosts are namespaces; else all of them are this machine, and none can be cut off.
    """

    def __init__(self, hosts: int):
        """`hosts`: beside the hub."""
        self.hosts, self._holders = hosts, list[subprocess.Popen]()
        can = shutil.which("unshare") and shutil.which("nsenter") and shutil.which("ip")
        self.apart = (
            bool(can) and not subprocess.run(["unshare", "-n", "true"], capture_output=True, check=False).returncode
        )

    def address(self, host: int) -> str:
        """IP address of a host."""
        return f"10.77.0.{host + 1}" if self.apart else "127.0.0.1"

    def on(self, host: int) -> list[str]:
        """What has to stand before a command that is run there."""
        return ["nsenter", "--net", "--target", str(self._holders[host].pid)] if self.apart else []

    def cut(self, host: int) -> None:
        """Takes the host's plug out: nobody is told."""
        self._ip(0, f"link set port{host} down")

    def _ip(self, host: int, words: str) -> None:
        subprocess.run([*self.on(host), "ip", *words.split()], check=True)

    def __enter__(self) -> "Network":
        if self.apart:
            try:
                self._build()
            except BaseException:
                self.__exit__()
                raise
        return self

    def _build(self) -> None:
        for host in range(self.hosts + 1):
            holder = subprocess.Popen(
                ["unshare", "-n", "sh", "-c", f"echo; exec sleep {LASTS}"], stdout=subprocess.PIPE
            )
            self._holders.append(holder)
            assert holder.stdout is not None
            holder.stdout.readline()  # the namespace is there
            self._ip(host, "link set lo up")
        self._ip(0, "link add bridge0 type bridge")
        self._ip(0, f"addr add {self.address(0)}/24 dev bridge0")
        self._ip(0, "link set bridge0 up")
        for host in range(1, self.hosts + 1):
            self._ip(0, f"link add port{host} type veth peer name plug netns {self._holders[host].pid}")
            self._ip(0, f"link set port{host} master bridge0 up")
            self._ip(host, f"addr add {self.address(host)}/24 dev plug")
            self._ip(host, "link set plug up")

    def __exit__(self, *_: object) -> None:
        for holder in self._holders:  # its links go with a namespace
            holder.kill()
            holder.communicate()
        self._holders.clear()
