"""What all tests share."""

import importlib.util

# In torch's CUDA build: its compiler's LLVM crashes when it is loaded after the software renderer's.
if importlib.util.find_spec("triton") is not None:
    import torch._dynamo  # noqa: F401
