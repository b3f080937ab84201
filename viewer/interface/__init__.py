"""Parts of the user interface that know neither the scene nor the window's state: layout, theme, dialogs and the fading
of notices."""
