"""The stages of the pipeline. Each stage has one module, which contains the stage's file paths, settings and work
function."""
