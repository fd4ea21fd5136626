"""CRC-32 (R-6.3-1), by ISA-L where it is installed: zlib takes up to fifteen times as long."""

try:
    from isal.isal_zlib import crc32
except ImportError:  # isal is an extra
    from zlib import crc32

__all__ = ["crc32"]
