"""Two rows of a direction cosine matrix; the third is their cross product (the Darboux problem)."""

from fastatt._jit import kernel
from fastatt.kernels import vec3
from fastatt.kernels.vec3 import cross, dot


@kernel
def close_rows(a, b):
    """Matrix of two orthonormal rows, the third being their cross product.

    Parameters
    ----------
    a, b : tuple of 3 float
        First and second row.

    Returns
    -------
    tuple of 9 float
        Rotation matrix.
    """
    return a + b + cross(a, b)


@kernel
def orthonormalise_rows(a, b):
    """Orthonormalise two nearly orthonormal rows, to second order.

    Parameters
    ----------
    a, b : tuple of 3 float
        First and second row.

    Returns
    -------
    tuple of two tuples of 3 float
        The rows.

    Notes
    -----
    Half of a·b is removed from each row, and the rows are scaled.

    References
    ----------
    Premerlani and Bizard, "Direction cosine matrix IMU: theory" (2009), equations 18 to 21.
    """
    F = type(a[0])
    e = F(0.5) * dot(a, b)
    p = (a[0] - e * b[0], a[1] - e * b[1], a[2] - e * b[2])
    r = (b[0] - e * a[0], b[1] - e * a[1], b[2] - e * a[2])
    f = F(1.5) - F(0.5) * dot(p, p)
    g = F(1.5) - F(0.5) * dot(r, r)
    return vec3.scale(f, p), vec3.scale(g, r)
