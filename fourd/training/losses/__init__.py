"""Terms of the training loss, one file for each. To add a term:

1. Write ``losses/NAME.py`` with a frozen dataclass that satisfies :class:`fourd.training.losses.term.LossTerm`.
2. Add its weight to ``LossConfig`` in ``training/config.py`` and run ``python tools/site/configuration_page.py``.
3. Add it to ``common_terms`` or ``full_scene_terms`` in ``losses/terms.py``, the one list of terms.
4. Test its value and gradient in ``tests/training/losses/test_NAME.py``.
5. Its weighted value then appears as ``loss/NAME`` in ``metrics.jsonl`` and TensorBoard.
"""
