"""The filters' numpy twins, which step on a CPU. No torch, no files."""
