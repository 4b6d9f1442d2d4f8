"""Convection, diffusion and reaction with known solutions, by bilinear elements of scikit-fem with SUPG.

``-eps Laplace(u) + b . grad(u) + c u = f`` on the unit square or another domain, with f and the boundary values of a
given u. The names are those of the page on adapting.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np
import skfem
from scipy.sparse.linalg import splu
from skfem.helpers import dot, grad

import equimesh as em

Parameter: TypeAlias = Literal["usual", "thin"]
"""The SUPG parameter: by the length along the stream alone, or bounded by the thickness of the cell as well."""
INTEGRATION_ORDER = 6
"""The degree of polynomials that the matrices are exact for."""
ERROR_ORDER = 11
"""The degree of polynomials that the integrals of the errors are exact for."""


@dataclass(frozen=True, kw_only=True)
class Problem:
    """One problem with its solution ``u``, an expression in x and y."""

    u: str
    eps: float
    b: tuple[float, float] = (0.0, 0.0)
    c: float = 0.0
    domain: em.Domain = field(default_factory=em.Rectangle)

    @cached_property
    def solution(self) -> em.Expression:
        """u with its derivatives."""
        return em.Expression(self.u)

    def solve(self, mesh: em.Mesh, parameter: Parameter = "thin") -> np.ndarray:
        """The solution at the nodes, shape ``(n_xi, n_eta)``."""
        basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1(), intorder=INTEGRATION_ORDER)
        u, u_x, u_y, u_xx, _, u_yy = self.solution.evaluate(*basis.global_coordinates(), order=2)
        (b_x, b_y), c, eps = self.b, self.c, self.eps
        source = -eps * (u_xx + u_yy) + b_x * u_x + b_y * u_y + c * u
        tau = supg_parameter(basis.mesh, self.b, eps, parameter)[:, None] * np.ones_like(source)

        def along(v):
            return b_x * grad(v)[0] + b_y * grad(v)[1]

        def form(v, test, at):
            return eps * dot(grad(v), grad(test)) + (along(v) + c * v) * (test + at.tau * along(test))

        matrix = skfem.BilinearForm(form).assemble(basis, tau=tau).tocsc()
        load = skfem.LinearForm(lambda test, at: at.f * (test + at.tau * along(test)))
        right = load.assemble(basis, f=source, tau=tau)
        found = self.solution.evaluate(mesh.x.ravel(), mesh.y.ravel())[0]
        sides = basis.mesh.boundary_nodes()
        inner = np.setdiff1d(np.arange(found.size), sides)
        known = right[inner] - matrix[inner][:, sides] @ found[sides]
        found[inner] = splu(matrix[inner][:, inner].tocsc()).solve(known)
        return found.reshape(mesh.x.shape)

    def errors(self, mesh: em.Mesh, values: np.ndarray) -> tuple[float, float]:
        """The errors of nodal values in the L2 norm and the H1 seminorm."""
        basis = skfem.Basis(mesh.to_skfem(), skfem.ElementQuad1(), intorder=ERROR_ORDER)
        u, u_x, u_y = self.solution.evaluate(*basis.global_coordinates(), order=1)
        found = basis.interpolate(values.ravel())
        slopes = (found.grad[0] - u_x) ** 2 + (found.grad[1] - u_y) ** 2
        squares = ((found - u) ** 2 * basis.dx).sum(), (slopes * basis.dx).sum()
        return float(np.sqrt(squares[0])), float(np.sqrt(squares[1]))


def supg_parameter(mesh: skfem.MeshQuad, b: tuple[float, float], eps: float, kind: Parameter) -> np.ndarray:
    """tau of every cell, zero without a stream."""
    speed = np.hypot(*b)
    if speed == 0.0:
        return np.zeros(mesh.nelements)
    centre = skfem.Basis(mesh, skfem.ElementQuad1(), quadrature=(np.array([[0.5], [0.5]]), np.ones(1)))
    slopes = [b[0] * shape[0].grad[0, :, 0] + b[1] * shape[0].grad[1, :, 0] for shape in centre.basis]
    length = 2.0 * speed / np.abs(slopes).sum(axis=0)
    peclet = speed * length / (2.0 * eps)
    tau = length / (2.0 * speed) * (1.0 / np.tanh(peclet) - 1.0 / peclet)
    if kind == "usual":
        return tau
    jacobians = np.moveaxis(centre.mapping.DF(np.array([[0.5], [0.5]]))[..., 0], -1, 0)
    thickness = np.linalg.svd(jacobians, compute_uv=False)[:, -1]
    return np.minimum(tau, thickness**2 / (12.0 * eps))


def layer(v: str, width: float) -> str:
    """A function of one coordinate that falls from about 1 to 0 in a layer before 1."""
    return f"(1 - exp(({v} - 1)/{width:.12g}))"


PROBLEMS = {
    "A": Problem(u="tanh(60*(x + y/2 - 0.75))", eps=1e-3, b=(1.0, -2.0)),
    "A, across": Problem(u="tanh(60*(x + y/2 - 0.75))", eps=1e-3, b=(2.0, 3.0)),
    "A200": Problem(u="tanh(200*(x + y/2 - 0.75))", eps=1e-3, b=(1.0, -2.0)),
    "A200, across": Problem(u="tanh(200*(x + y/2 - 0.75))", eps=1e-3, b=(2.0, 3.0)),
    "B": Problem(u="(x - exp((x - 1)/0.001))*(y - exp((y - 1)/0.001))", eps=1e-3, b=(1.0, 1.0)),
    "C": Problem(
        u=f"(1 + tanh(60*(y - x/2 - 0.25)))/2*{layer('x', 1e-3)}*{layer('y', 1e-3)}",
        eps=1e-3,
        b=(1.0, 0.5),
    ),
    "D": Problem(
        u="(1 - (exp(-x/0.005) + exp((x - 1)/0.005)))*(1 - (exp(-y/0.005) + exp((y - 1)/0.005)))",
        eps=2.5e-5,
        c=1.0,
    ),
    "E": Problem(u="tanh(20*((x - 0.5)**2 + (y - 0.5)**2 - 0.09))", eps=1.0),
    "A2": Problem(
        u="16*x*(1 - x)*y*(1 - y)*(0.5 + atan(200*(0.0625 - (x - 0.5)**2 - (y - 0.5)**2))/pi)",
        eps=1e-3,
        b=(2.0, 3.0),
        c=2.0,
    ),
}
"""Problems on which the loop was chosen."""
UNSEEN = {
    "channel": Problem(u=f"{layer('x', 1e-3)}*(1 - exp(-y/0.03) - exp((y - 1)/0.03))", eps=1e-3, b=(1.0, 0.0)),
    "wave": Problem(u="tanh(80*(y - 0.5 - 0.2*sin(2*pi*x)))", eps=1e-3, b=(1.0, 0.3)),
    "cross": Problem(u="tanh(50*(x - y + 0.1)) + tanh(50*(x + y - 1.1))", eps=1e-3, b=(1.0, 2.0), c=1.0),
    "sector": Problem(
        u="(1 - exp((sqrt(x**2 + y**2) - 2)/0.005))*tanh(40*(x - y/2 - 0.6))",
        eps=1e-3,
        b=(1.0, 0.5),
        domain=em.AnnulusSector(radii=(1.0, 2.0), angles=(0.0, 90.0)),
    ),
}
"""Problems that nothing was tuned on."""
UNRESOLVED = {
    "C, eps = 1e-5": Problem(
        u=f"(1 + tanh(60*(y - x/2 - 0.25)))/2*{layer('x', 1e-5)}*{layer('y', 1e-5)}", eps=1e-5, b=(1.0, 0.5)
    ),
}
"""Problems whose layers are too thin for 65 x 65 points."""
