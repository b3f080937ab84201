"""The stages of the pipeline. Each stage has one module, which contains the stage's typed files, its settings and its
work."""
