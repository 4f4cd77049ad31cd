"""Writers of clip file formats: components of kind ``clip_writer``."""
