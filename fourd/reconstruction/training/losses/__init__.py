"""Terms of the training loss. Each loss term has its own file. To add a term:

1. Write ``losses/NAME.py`` with a frozen dataclass that satisfies
:class:`fourd.reconstruction.training.losses.term.LossTerm`.
2. Add the term's weight to ``LossConfig`` in ``training/config.py``. Run ``python tools/site/configuration_page.py``.
3. Add the term to ``common_terms`` or ``full_scene_terms`` in ``losses/terms.py``.
4. Test the term's value and gradient in ``tests/training/losses/test_NAME.py``.
5. Check that the weighted value of the term appears as ``loss/NAME`` in ``metrics.jsonl`` and TensorBoard.
"""
