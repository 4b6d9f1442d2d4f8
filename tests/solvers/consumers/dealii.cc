// deal.II reads a Gmsh mesh, says what it holds, and solves the Poisson problem on it: dealii MESH STEEP SLANT PLACE.
// It prints points with values, cells, edges of the boundary with their numbers, each list after its name and length.

#include <deal.II/base/config.h>
#include <deal.II/base/function.h>
#include <deal.II/base/quadrature_lib.h>
#include <deal.II/dofs/dof_handler.h>
#include <deal.II/dofs/dof_tools.h>
#include <deal.II/fe/fe_q.h>
#include <deal.II/fe/fe_simplex_p.h>
#include <deal.II/fe/fe_values.h>
#include <deal.II/fe/mapping_fe.h>
#include <deal.II/grid/grid_in.h>
#include <deal.II/grid/tria.h>
#include <deal.II/lac/affine_constraints.h>
#include <deal.II/lac/dynamic_sparsity_pattern.h>
#include <deal.II/lac/full_matrix.h>
#include <deal.II/lac/precondition.h>
#include <deal.II/lac/solver_cg.h>
#include <deal.II/lac/sparse_matrix.h>
#include <deal.II/lac/vector.h>
#include <deal.II/numerics/vector_tools.h>

#include <fstream>
#include <iomanip>
#include <iostream>
#include <memory>

using namespace dealii;

const types::boundary_id RIGHT = 2;

struct Exact : Function<2>
{
  double steep, slant, place;
  double value(const Point<2> &p, const unsigned int = 0) const override
  {
    return std::tanh(steep * (p[0] + slant * p[1] - place));
  }
  Tensor<1, 2> gradient(const Point<2> &p, const unsigned int = 0) const override
  {
    const double along = steep * (1 - value(p) * value(p));
    return Tensor<1, 2>({along, slant * along});
  }
  double load(const Point<2> &p) const
  {
    const double w = value(p);
    return 2 * steep * steep * (1 + slant * slant) * w * (1 - w * w);
  }
};

int main(int argc, char **argv)
{
  if (argc != 5)
    {
      std::cout << DEAL_II_PACKAGE_VERSION << std::endl;
      return 0;
    }
  Exact exact;
  exact.steep = std::stod(argv[2]);
  exact.slant = std::stod(argv[3]);
  exact.place = std::stod(argv[4]);

  Triangulation<2> mesh;
  GridIn<2>        reader(mesh);
  std::ifstream    file(argv[1]);
  reader.read_msh(file);

  const bool triangles = mesh.all_reference_cells_are_simplex();
  std::unique_ptr<FiniteElement<2>> element, linear;
  if (triangles)
    element = std::make_unique<FE_SimplexP<2>>(1), linear = std::make_unique<FE_SimplexP<2>>(1);
  else
    element = std::make_unique<FE_Q<2>>(1), linear = std::make_unique<FE_Q<2>>(1);
  const MappingFE<2>  mapping(*linear);
  const Quadrature<2> inside = triangles ? Quadrature<2>(QGaussSimplex<2>(4)) : Quadrature<2>(QGauss<2>(5));
  const Quadrature<1> along  = QGauss<1>(5);

  DoFHandler<2> dofs(mesh);
  dofs.distribute_dofs(*element);
  AffineConstraints<double> fixed;
  for (const types::boundary_id side : {1, 3, 4})
    VectorTools::interpolate_boundary_values(mapping, dofs, side, exact, fixed);
  fixed.close();
  DynamicSparsityPattern pattern(dofs.n_dofs());
  DoFTools::make_sparsity_pattern(dofs, pattern, fixed, false);
  SparsityPattern sparsity;
  sparsity.copy_from(pattern);
  SparseMatrix<double> matrix(sparsity);
  Vector<double>       right_side(dofs.n_dofs()), u(dofs.n_dofs());

  FEValues<2> cell_values(mapping, *element, inside,
                          update_values | update_gradients | update_quadrature_points | update_JxW_values);
  FEFaceValues<2> face_values(mapping, *element, hp::QCollection<1>(along),
                              update_values | update_quadrature_points | update_normal_vectors | update_JxW_values);
  const unsigned int                   n = element->n_dofs_per_cell();
  FullMatrix<double>                   local(n, n);
  Vector<double>                       local_right(n);
  std::vector<types::global_dof_index> numbers(n);
  for (const auto &cell : dofs.active_cell_iterators())
    {
      cell_values.reinit(cell);
      local = 0, local_right = 0;
      for (const unsigned int q : cell_values.quadrature_point_indices())
        for (unsigned int i = 0; i < n; ++i)
          {
            for (unsigned int j = 0; j < n; ++j)
              local(i, j) += cell_values.shape_grad(i, q) * cell_values.shape_grad(j, q) * cell_values.JxW(q);
            local_right(i) +=
              exact.load(cell_values.quadrature_point(q)) * cell_values.shape_value(i, q) * cell_values.JxW(q);
          }
      for (const unsigned int f : cell->face_indices())
        if (cell->face(f)->at_boundary() && cell->face(f)->boundary_id() == RIGHT)
          {
            face_values.reinit(cell, f);
            for (const unsigned int q : face_values.quadrature_point_indices())
              for (unsigned int i = 0; i < n; ++i)
                local_right(i) += (exact.gradient(face_values.quadrature_point(q)) * face_values.normal_vector(q)) *
                                  face_values.shape_value(i, q) * face_values.JxW(q);
          }
      cell->get_dof_indices(numbers);
      fixed.distribute_local_to_global(local, local_right, numbers, matrix, right_side);
    }
  SolverControl            control(5000, 1e-13 * right_side.l2_norm());
  SolverCG<Vector<double>> solver(control);
  PreconditionSSOR<SparseMatrix<double>> preconditioner;
  preconditioner.initialize(matrix, 1.2);
  solver.solve(matrix, u, right_side, preconditioner);
  fixed.distribute(u);

  std::vector<double> nodal(mesh.n_vertices());
  for (const auto &cell : dofs.active_cell_iterators())
    for (const unsigned int v : cell->vertex_indices())
      nodal[cell->vertex_index(v)] = u(cell->vertex_dof_index(v, 0));
  std::cout << std::setprecision(17) << "points " << mesh.n_vertices() << "\n";
  for (unsigned int k = 0; k < mesh.n_vertices(); ++k)
    std::cout << mesh.get_vertices()[k] << " " << nodal[k] << "\n";
  // the area of a cell has the sign of its Jacobian
  std::cout << "cells " << mesh.n_active_cells() << "\n";
  for (const auto &cell : dofs.active_cell_iterators())
    {
      cell_values.reinit(cell);
      double area = 0;
      for (const unsigned int q : cell_values.quadrature_point_indices())
        area += cell_values.JxW(q);
      std::cout << area << "\n";
    }
  unsigned int on_boundary = 0;
  for (const auto &face : mesh.active_face_iterators())
    on_boundary += face->at_boundary();
  std::cout << "edges " << on_boundary << "\n";
  for (const auto &face : mesh.active_face_iterators())
    if (face->at_boundary())
      std::cout << face->vertex_index(0) << " " << face->vertex_index(1) << " " << face->boundary_id() << "\n";
}
