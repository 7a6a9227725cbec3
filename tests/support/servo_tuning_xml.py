"""Writes what SINUMERIK's auto servo tuning saves of a measured plant: doubles in base 85, in the elements around."""

import numpy as np

DIGITS = "0123456789abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ!#$`()*+-/:;=?@[]^_{|}~"


def base85(values):
    """Each half of a double in five digits, or a point where it is zero."""
    words = np.ascontiguousarray(values, ">f8").view(">u4")
    return "".join("." if word == 0 else _digits(int(word)) for word in words)


def _digits(word):
    return "".join(DIGITS[word // 85**power % 85] for power in (4, 3, 2, 1, 0))


def array(name, kind, values):
    text = base85(values)
    lines = "\n".join(text[k : k + 80] for k in range(0, len(text), 80))
    return (
        f'<NumericArray satclassid="4" elementtype="{kind}" format="base85" name="{name}">\n'
        f'<unsigned_int name="m_length">{len(values)}</unsigned_int>\n'
        f'<raw name="m_pNumberArray">{lines}</raw>\n</NumericArray>\n'
    )


def response(name, frequency, value):
    pairs = np.stack([np.real(value), np.imag(value)], axis=1).ravel()
    return (
        f'<FrequencyResponseFunction satclassid="6" name="{name}">\n'
        + array("m_ValueVector", "ComplexNumber", pairs)
        + array("m_FrequencyVector", "double", frequency)
        + "</FrequencyResponseFunction>\n"
    )


def record(frequency, value, coherence):
    return (
        '<PlantMeasRecord satclassid="196" name="m_listMechPlants_el">\n<unsigned_int name="m_uId">0</unsigned_int>\n'
        + response("m_pPlant", frequency, value)
        + response("m_pMeasCoherence", frequency, coherence + 0j)
        + "</PlantMeasRecord>\n"
    )


def document(*records, root="DynamicModelAxisController"):
    model = '<PlantMeasRecord name="m_listMechResponse_el"><TransferFunction name="m_pPlant"/></PlantMeasRecord>\n'
    return (
        f'<?xml version="1.0" encoding="ISO-8859-1"?>\n<!-- 4.96 -->\n<{root} satclassid="30">\n'
        f'<string name="m_szAxisName">AX1</string>\n<LinkedList name="m_listMechResponse">{model}</LinkedList>\n'
        f'<LinkedList name="m_listMechPlants">\n{"".join(records)}</LinkedList>\n</{root}>\n'
    )
