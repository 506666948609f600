import numpy as np


def predict_grid(belief, kernel):
    moved = np.convolve(belief, kernel)
    cells = len(belief)
    moved[cells - 1] = moved[cells - 1 :].sum()
    return moved[:cells]


def update_grid(belief, likelihood):
    product = belief * likelihood
    total = product.sum()
    return product / total if total > 0 else belief


def reading_likelihood(reading_in, expected_in, std_in, p_random):
    gauss = np.exp(-0.5 * ((reading_in - expected_in) / std_in) ** 2) / (std_in * np.sqrt(2 * np.pi))
    return (1 - p_random) * gauss + p_random / 255
