"""Many sealed trials: made and scored in one go, set side by side, learnt from; a rival to compare with."""
