"""The options that name a cluster, for every program that can run on one."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from models.errors import InputError


@dataclass
class ClusterOptions:
    """Which cluster, and how it is spoken to."""

    scheduler: str | None = None  # address of a running Dask cluster, tcp:// or tls://...; its own workers are used
    tls_ca: Path | None = None  # for tls://: file of the authority that signed the cluster's certificates, PEM
    tls_cert: Path | None = None  # and of the certificate that this program shows
    tls_key: Path | None = None  # and of its key

    def check_cluster(self) -> None:
        """Raises InputError for TLS with files missing, or files without TLS."""
        files = {"--tls-ca": self.tls_ca, "--tls-cert": self.tls_cert, "--tls-key": self.tls_key}
        given = [option for option, file in files.items() if file is not None]
        if 0 < len(given) < len(files):
            raise InputError(f"{' and '.join(given)} alone will not do: give {', '.join(files)}, or none of them")
        encrypted = self.scheduler is not None and self.scheduler.startswith("tls://")
        if encrypted and not given:
            raise InputError(f"the scheduler {self.scheduler} speaks TLS: give {', '.join(files)}")
        if given and not encrypted:
            raise InputError(f"{given[0]} is for a --scheduler at tls://..., not {self.scheduler}: leave one out")
        for option, file in files.items():
            if file is not None and not file.is_file():
                raise InputError(f"{option} {file} is no file: give one in the PEM format")

    def require_cluster(self) -> None:
        """Raises InputError for a --scheduler that cannot be used; asked before anything is written."""
        if self.scheduler is not None:
            self.cluster({}).__exit__()

    def cluster(self, files: dict[str, bytes]) -> Any:
        """A DaskPool at --scheduler with these `files`; raises InputError as it does, and for Dask's configuration."""
        try:
            from diagrams.sweeps.cluster import DaskPool
        except ImportError:
            raise
        except Exception as error:  # it reads its configuration as it is imported, and raises what comes
            words = "mend its files in ~/.config/dask, or the variables DASK_..."
            raise InputError(f"Dask cannot use its configuration ({error!r:.200}): {words}") from error
        assert self.scheduler is not None
        return DaskPool(self.scheduler, files, self.tls)

    @property
    def tls(self) -> tuple[Path, Path, Path] | None:
        """Files of the authority, of this side's certificate and of its key; None without TLS."""
        if self.tls_ca is None or self.tls_cert is None or self.tls_key is None:
            return None
        return self.tls_ca, self.tls_cert, self.tls_key
